import json
import re
import shutil

import cv2
from mv_slapse.errors import UnusableInput, UsageError
from mv_slapse.simulation.street import StreetSettings
from mv_slapse.storage.tables import OBSTACLES_HEADER
from mv_slapse.storage.tum import parse_stamp
from mv_slapse.tools import eval as tool
import numpy as np
import pytest


@pytest.fixture
def out(clip, tmp_path):
    return shutil.copytree(clip.out, tmp_path / 'out')


def test_a_rendered_street_gives_all_figures(clip):
    figures = tool.evaluate(clip.out, clip.truth)
    assert {'ate_mean_m', 'ate_max_m', 'ate_mean_percent', 'ate_rigid_mean_percent', 'distance_m',
            'n_poses', 'plane_depth_error_m', 'plane_normal_error_deg', 'n_planes',
            'movers_found', 'movers_total', 'false_obstacles_per_frame'} <= set(figures)
    assert figures['ate_mean_percent'] < 5
    assert figures['distance_m'] == pytest.approx(10 * 20 / 15, rel=0.15)


def test_a_free_scale_is_said_and_gives_no_rigid_error(clip, out):
    summary = json.loads((out / 'summary.json').read_text())
    (out / 'summary.json').write_text(json.dumps(summary | {'scale_status': 'unknown'}))
    figures = tool.evaluate(out, clip.truth / 'ground_truth.tum')
    assert not [name for name in figures if 'rigid' in name]
    assert 'the scale is free' in tool.text(figures)
    assert 'the scale is free' not in tool.text(tool.evaluate(clip.out, clip.truth))


def test_the_way_is_drawn(clip, tmp_path):
    tool.plot(tmp_path / 'way.png', clip.out, clip.truth)
    image = cv2.imread(str(tmp_path / 'way.png'))
    assert image.shape == (800, 800, 3)
    assert np.ptp(image) == 255
    with pytest.raises(UsageError, match='--plot needs a true trajectory'):
        tool.plot(tmp_path / 'none.png', clip.out, None)


def test_a_trajectory_alone_gives_what_it_can(clip):
    figures = tool.evaluate(clip.out, clip.truth / 'ground_truth.tum')
    assert figures['ate_mean_m'] >= 0
    assert 'plane_depth_error_m' not in figures
    assert 'movers_found' not in figures


def test_the_truth_itself_has_no_error(clip, out):
    shutil.copy(clip.truth / 'ground_truth.tum', out / 'trajectory.tum')
    figures = tool.evaluate(out, clip.truth)
    assert figures['ate_max_m'] == pytest.approx(0, abs=1e-6)
    assert figures['scale'] == pytest.approx(1)


def test_shifted_stamps_are_shifted_back(clip, out):
    rows = (line.split(' ', 1) for line in (out / 'trajectory.tum').read_text().splitlines())
    (out / 'trajectory.tum').write_text(''.join(
        f'{parse_stamp(stamp) / 1e9 + 100:.9f} {rest}\n' for stamp, rest in rows))
    with pytest.raises(UnusableInput, match='--stamp-offset'):
        tool.evaluate(out, clip.truth / 'ground_truth.tum')
    shifted = tool.evaluate(out, clip.truth / 'ground_truth.tum', stamp_offset=100.0)
    expected = tool.evaluate(clip.out, clip.truth / 'ground_truth.tum')
    assert shifted['ate_mean_m'] == pytest.approx(expected['ate_mean_m'])


def test_labelled_points_and_boxes_are_scored(clip, tmp_path):
    x = np.random.default_rng(0).uniform(0, 300, (30, 21, 2))
    np.savez(tmp_path / 'labels.npz', tracks=x, visible=np.ones((30, 21), bool),
             label=np.repeat([1, 2], 15))
    (tmp_path / 'boxes.csv').write_text('frame,x,y,width,height\n0,1,1,9,9\n2,1,1,9,9\n')
    figures = tool.evaluate(clip.out, None, tool.Marks(
        tmp_path / 'labels.npz', tmp_path / 'boxes.csv'))
    assert figures['movers_total'] == 1
    assert figures['boxes_total'] >= 1
    assert figures['stationary_called_moving_percent'] is not None

def test_the_height_of_the_camera_tells_what_is_aside_where_the_scale_is_free(out):
    labels = out / 'points.npz'  # of nothing, so that what is confirmed is no mover
    np.savez(labels, tracks=np.zeros((1, 21, 2)), visible=np.zeros((1, 21), bool), label=[1])
    path = tool.read_results(out).trajectory
    x, y, z = path.positions[-1] + (3.0, 0.0, 5.0)  # three metres beside the way of the camera
    (out / 'obstacles.csv').write_text(
        f'{OBSTACLES_HEADER}\n{path.stamps[-1] / 1e9:.9f},1,confirmed,9,9,9,9,'
        f'{x},{y},{z},0,0,0,1,9\n')

    def braked(**known):
        found = tool.evaluate(out, None, tool.Marks(labels, **known))
        return found['false_braking_frames']

    assert braked() == 0
    summary = json.loads((out / 'summary.json').read_text())
    (out / 'summary.json').write_text(json.dumps(summary | {'scale_status': 'unknown'}))
    height = StreetSettings().camera_height
    assert braked() == 1  # nothing is too far aside
    assert [braked(camera_height=h) for h in (height, height / 2)] == [0, 1]
    (out / 'map.json').write_text(re.sub('"is_ground": true', '"is_ground": false',
                                         (out / 'map.json').read_text()))
    assert braked(camera_height=height) == 1


def test_covariances_of_obstacles_come_from_the_messages(clip, out):
    table = tool.read_results(out).obstacles
    found = tool.read_covariances(out)
    assert set(found) == set(zip(table['stamp'].tolist(), table['id'].astype(int).tolist(),
                                 strict=True))
    assert all(P.shape == (6, 6) and np.all(np.linalg.eigvalsh(P) > 0) for P in found.values())
    (out / 'results.mcap').unlink()
    assert tool.read_covariances(out) == {}


def test_covariances_of_poses_are_judged_where_the_messages_hold_them(clip, out):
    figures = tool.evaluate(out, clip.truth)
    assert figures['position_covered_percent'] > 50
    assert 0 < figures['pose_nees'] < 60
    assert tool.evaluate(out, clip.truth / 'ground_truth.tum')['pose_nees'] is None
    stamps = tool.read_results(out).trajectory.stamps
    assert set(tool.read_pose_covariances(out)) == set(stamps[1:].tolist())
    (out / 'results.mcap').unlink()
    assert tool.evaluate(out, clip.truth)['position_covered_percent'] is None


def test_an_annotation_is_scored_against_the_last_key_frame(clip, tmp_path):
    path = tmp_path / 'annotation.json'
    path.write_text('[{"velocity": [0, 0], "position": [9, 0], '
                    '"bbox": {"top": 1, "left": 1, "bottom": 3, "right": 3}}]')
    figures = tool.evaluate(clip.out, marks=tool.Marks(annotation=path))
    assert (figures['annotated_vehicles'], figures['annotated_vehicles_met']) == (1, 0)
    path.write_text('[{}]')
    with pytest.raises(UnusableInput, match='annotation of vehicles'):
        tool.evaluate(clip.out, marks=tool.Marks(annotation=path))


def test_without_any_truth_there_is_nothing_to_do(clip):
    with pytest.raises(UsageError, match='--ground-truth'):
        tool.evaluate(clip.out)


def test_a_rate_is_needed_to_count_frames(out, tmp_path):
    (out / 'summary.json').unlink()
    (tmp_path / 'boxes.csv').write_text('frame,x,y,width,height\n')
    with pytest.raises(UsageError, match='--fps'):
        tool.evaluate(out, marks=tool.Marks(boxes=tmp_path / 'boxes.csv'))


def test_a_folder_without_results_is_refused(clip, tmp_path):
    with pytest.raises(UnusableInput, match='no trajectory.tum; write one with'):
        tool.evaluate(tmp_path, clip.truth)


def test_figures_are_shown_one_a_line():
    assert tool.text({'a': 1, 'long_name': 0.123456, 'none': None}).splitlines() == [
        'a          1', 'long_name  0.1235', 'none       -']


def test_evo_agrees_on_the_real_sequence(data, tmp_path):
    pytest.importorskip('evo')
    from evo.core import metrics, sync
    from evo.tools import file_interface
    truth = data / 'kitti00' / 'ground_truth.tum'
    rng = np.random.default_rng(0)
    rows = np.loadtxt(truth)[::2]
    rows[:, 1:4] = 0.7 * rows[:, 1:4] + rng.normal(0, 0.1, (len(rows), 3))
    out = tmp_path / 'out'
    out.mkdir()
    np.savetxt(out / 'trajectory.tum', rows, fmt='%.9f')
    (out / 'planes.csv').write_text(tool.PLANES_HEADER + '\n')
    (out / 'obstacles.csv').write_text(tool.OBSTACLES_HEADER + '\n')
    np.savez(out / 'labels.npz', stamp=rows[1:, 0], x=[7.5], y=[7.5],
             label=np.zeros((len(rows) - 1, 1)), plane=np.zeros((len(rows) - 1, 1)))
    (out / 'summary.json').write_text(json.dumps({'key_frames': len(rows)}))
    pair = sync.associate_trajectories(
        file_interface.read_tum_trajectory_file(str(truth)),
        file_interface.read_tum_trajectory_file(str(out / 'trajectory.tum')))
    pair[1].align(pair[0], correct_scale=True)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data(pair)
    figures = tool.evaluate(out, truth)
    assert figures['ate_mean_m'] == pytest.approx(ape.get_statistic(metrics.StatisticsType.mean),
                                                  rel=1e-6)
    assert figures['ate_max_m'] == pytest.approx(ape.get_statistic(metrics.StatisticsType.max),
                                                 rel=1e-6)
