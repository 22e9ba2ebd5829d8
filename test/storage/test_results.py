from contextlib import ExitStack, suppress
from dataclasses import replace
import errno
import json
import os
from pathlib import Path
import subprocess
import sys
from types import SimpleNamespace

import made_up
from mv_slapse import fields, planner_fields
from mv_slapse.errors import UnusableOutput, UsageError
from mv_slapse.geometry.camera import Camera
from mv_slapse.level import frames_from_transforms
from mv_slapse.records import ScaleStatus, TrackingStatus
from mv_slapse.storage import waiting_rows
from mv_slapse.storage.archives import MapArchive
from mv_slapse.storage.bag_reader import BagReader
from mv_slapse.storage.results import ResultsWriter
from mv_slapse.storage.tables import OBSTACLES_HEADER, PLANES_HEADER, read_table
from mv_slapse.storage.tum import read_trajectory
import numpy as np
import pytest

PERIOD = 100_000_000
STATUSES = (TrackingStatus.INITIALISING, TrackingStatus.OK, TrackingStatus.LOST,
            TrackingStatus.PREDICTED)


def made_up_step(rng, k, status=TrackingStatus.OK):
    stamp = (k + 1) * PERIOD
    return SimpleNamespace(
        correspondences=made_up.correspondences(rng, stamp=stamp),
        extraction=made_up.extraction(rng, stamp=stamp),
        scene=made_up.scene(rng, stamp, status), obstacles=[made_up.obstacle(rng, stamp=stamp)],
        handovers=[made_up.handover(rng, stamp)])


@pytest.fixture
def steps(rng):
    made = [made_up_step(rng, k, status) for k, status in enumerate(STATUSES)]
    made[0].scene = replace(made[0].scene, baseline=0.0)  # it has not moved yet
    return made


@pytest.fixture
def out(tmp_path, steps):
    with ResultsWriter(tmp_path / 'out') as writer:
        for step in steps:
            writer.write(step)
        writer.close({'frames': 9})
    return tmp_path / 'out'


def test_a_run_leaves_the_files_of_the_contract(out):
    assert {path.name for path in out.iterdir()} == {
        'trajectory.tum', 'planes.csv', 'obstacles.csv', 'labels.npz', 'map.json', 'results.mcap',
        'summary.json'}
    assert json.loads((out / 'summary.json').read_text()) == {'frames': 9}


def test_only_poses_that_are_known_are_written_after_the_origin(out, steps):
    trajectory = read_trajectory(out / 'trajectory.tum')
    # the origin is the first key frame of the pair that has the first pose
    np.testing.assert_array_equal(trajectory.stamps, [PERIOD, 2 * PERIOD, 4 * PERIOD])
    np.testing.assert_array_equal(trajectory.positions[0], 0)
    np.testing.assert_allclose(trajectory.positions[2], steps[3].scene.t_world_from_cam,
                               atol=1e-9)


def test_the_origin_is_where_the_camera_first_moved_though_poses_came_later(tmp_path, steps):
    steps[0].scene = replace(steps[0].scene, baseline=1.0)
    with ResultsWriter(tmp_path) as writer:
        for step in steps:
            writer.write(step)
    trajectory = read_trajectory(tmp_path / 'trajectory.tum')
    np.testing.assert_array_equal(trajectory.stamps, [0, 2 * PERIOD, 4 * PERIOD])


def test_a_run_that_is_lost_throughout_has_no_pose(tmp_path, rng):
    with ResultsWriter(tmp_path) as writer:
        writer.write(made_up_step(rng, 0, TrackingStatus.LOST))
    assert not len(read_trajectory(tmp_path / 'trajectory.tum'))
    assert not len(read_table(tmp_path / 'planes.csv', PLANES_HEADER)['id'])
    assert '/odometry' not in BagReader(tmp_path / 'results.mcap').topics


def test_planes_and_obstacles_have_a_row_for_each_key_frame(out):
    planes = read_table(out / 'planes.csv', PLANES_HEADER)
    obstacles = read_table(out / 'obstacles.csv', OBSTACLES_HEADER)
    np.testing.assert_array_equal(planes['stamp'], [2 * PERIOD, 4 * PERIOD])
    np.testing.assert_array_equal(obstacles['stamp'], PERIOD * np.arange(1, 5))


def test_labels_have_a_row_for_each_key_frame(out, steps):
    with np.load(out / 'labels.npz') as labels:
        shapes = {name: labels[name].shape for name in labels}
        assert (labels['label'].dtype, labels['plane'].dtype) == (np.int8, np.int32)
        np.testing.assert_allclose(labels['stamp'], [0.1, 0.2, 0.3, 0.4])
        for k, step in enumerate(steps):
            np.testing.assert_array_equal(labels['label'][k], step.extraction.macroblock_label)
            np.testing.assert_array_equal(labels['plane'][k], step.extraction.macroblock_plane)
    n = 20 * 15
    assert shapes == {'stamp': (4,), 'stamp_ns': (4,), 'x': (n,), 'y': (n,), 'label': (4, n),
                      'plane': (4, n)}


def test_the_map_holds_every_plane_there_ever_was(tmp_path, rng):
    first, last = made_up_step(rng, 0), made_up_step(rng, 1)
    last.scene = replace(last.scene, planes=(made_up.map_plane(rng, 8),))
    with ResultsWriter(tmp_path) as writer:
        writer.write(first)
        writer.write(last)
    content = json.loads((tmp_path / 'map.json').read_text())
    assert (content['schema_version'], content['units']) == (1, 'm')
    assert content['scale_source'] == 'camera height'
    assert [(plane['id'], plane['is_current']) for plane in content['planes']] == [
        (7, False), (8, True)]
    np.testing.assert_allclose(content['planes'][1]['normal'], last.scene.planes[0].normal)


def test_a_plane_that_left_the_map_and_came_again_is_there_once_as_last_known(rng):
    archive, scene = MapArchive(), made_up_step(rng, 0).scene
    planes = [made_up.map_plane(rng, id) for id in (7, 8, 7, 9)]
    for shown in ((0, 1), (1,), (1, 2), (3,)):
        archive.add(replace(scene, planes=tuple(planes[i] for i in shown)))
    found = archive.content()['planes']
    assert [(plane['id'], plane['is_current']) for plane in found] == [
        (8, False), (7, False), (9, True)]
    np.testing.assert_allclose(found[1]['normal'], planes[2].normal)
    assert archive.content()['planes'] == found


def test_a_map_that_begins_anew_keeps_the_planes_of_the_one_before(rng):
    archive, scene = MapArchive(), made_up_step(rng, 0).scene
    planes = [made_up.map_plane(rng, id) for id in (0, 1, 0)]
    archive.add(replace(scene, planes=tuple(planes[:2])))
    archive.begin_anew()
    archive.add(replace(scene, planes=(planes[2],)))
    found = archive.content()['planes']
    assert [plane['is_current'] for plane in found] == [False, False, True]
    assert len({plane['id'] for plane in found}) == 3
    for one, plane in zip(found, planes, strict=True):
        np.testing.assert_allclose(one['normal'], plane.normal)


def scaled(plane, factor, place):
    """Return a plane, and what it says of itself, after all lengths changed about a place (3,)."""
    change = np.eye(4)
    change[3, :3], change[3, 3] = (factor - 1) * place, factor
    return replace(plane, depth=factor * plane.depth + (factor - 1) * plane.normal @ place,
                   covariance=change @ plane.covariance @ change.T,
                   outline=place + factor * (plane.outline - place))


def test_planes_that_left_the_map_follow_its_unit(rng):
    """As it becomes metric, about the last place published; what left before has a metre, too."""
    archive, scene = MapArchive(), made_up_step(rng, 0).scene
    planes = [made_up.map_plane(rng, id) for id in range(4)]
    t = rng.normal(0, 3, (5, 3))
    OK, LOST = TrackingStatus.OK, TrackingStatus.LOST
    for shown, unit, place, status in (
            ((0, 1), 1.0, t[0], OK), ((1,), 1.0, t[1], OK), ((2,), 0.4, t[2], OK),
            ((2,), 0.4, t[3], LOST), ((3,), 0.5, t[4], OK)):
        archive.add(replace(scene, planes=tuple(planes[i] for i in shown), unit=unit,
                            t_world_from_cam=place, status=status))
    expected = [scaled(scaled(planes[0], 0.4, t[1]), 1.25, t[2]),
                scaled(scaled(planes[1], 0.4, t[1]), 1.25, t[2]),
                scaled(planes[2], 1.25, t[2]), planes[3]]
    found = archive.content()['planes']
    assert [plane['id'] for plane in found] == [0, 1, 2, 3]
    for one, plane in zip(found, expected, strict=True):
        for name in ('normal', 'depth', 'covariance', 'outline'):
            np.testing.assert_allclose(one[name], getattr(plane, name), atol=1e-9)


def test_the_unit_of_a_map_that_begins_anew_is_not_that_of_the_one_before(rng):
    archive, scene = MapArchive(), made_up_step(rng, 0).scene
    planes = [made_up.map_plane(rng, id) for id in range(2)]
    archive.add(replace(scene, planes=(planes[0],), unit=0.4))
    archive.begin_anew()
    archive.add(replace(scene, planes=(planes[1],), unit=1.0))
    archive.add(replace(scene, planes=(planes[1],), unit=3.0))
    found = archive.content()['planes']
    assert found[0]['depth'] == planes[0].depth


def test_a_map_whose_planes_found_no_place_to_wait_is_refused(rng, monkeypatch):
    archive, scene = MapArchive(), made_up_step(rng, 0).scene
    with suppress(OSError), Path('/dev/full').open('w', buffering=1) as full:
        monkeypatch.setattr(archive._left, '_file', full)
        for id in (7, 8):
            archive.add(replace(scene, planes=(made_up.map_plane(rng, id),)))
        with pytest.raises(UnusableOutput, match='No space left'):
            archive.content()


def test_where_no_plane_can_wait_the_map_is_refused_when_it_is_asked_for(rng, monkeypatch):
    def refuse(_mode):
        raise OSError(errno.ENOSPC, 'No space left on device')

    monkeypatch.setattr(waiting_rows, 'TemporaryFile', refuse)
    archive = MapArchive()
    archive.add(made_up_step(rng, 0).scene)
    with pytest.raises(UnusableOutput, match='No space left'):
        archive.content()
    archive.close()


def test_a_map_of_unknown_scale_says_so(tmp_path, rng):
    step = made_up_step(rng, 0)
    step.scene = replace(step.scene, scale_status=ScaleStatus.UNKNOWN, scale_source='')
    with ResultsWriter(tmp_path) as writer:
        writer.write(step)
    assert json.loads((tmp_path / 'map.json').read_text())['units'] == 'map unit'


def test_the_bag_holds_what_the_nodes_publish(out, steps):
    reader = BagReader(out / 'results.mcap')
    assert {'/correspondences', '/planes/observations', '/planes/map', '/planes/handover',
            '/obstacles', '/odometry', '/pose', '/twist', '/path', '/tf', '/tf_static',
            '/planes/map_markers', '/obstacles/markers', '/obstacles/points', '/diagnostics',
            '/obstacles/polygons'} == set(reader.topics)
    messages = {topic: [msg for _, msg in reader.messages([topic])] for topic in reader.topics}
    assert (len(messages['/odometry']), len(messages['/planes/map'])) == (2, 4)
    frames = frames_from_transforms(messages['/tf_static'][0].transforms)
    scene = fields.scene_from_messages(messages['/odometry'][0], messages['/planes/map'][1],
                                       frames)
    np.testing.assert_allclose(scene.t_world_from_cam, steps[1].scene.t_world_from_cam,
                               atol=1e-9)
    sure = [planner_fields.sure(step.obstacles) for step in steps]
    clouds = [np.frombuffer(msg.data, planner_fields.POINT)
              for msg in messages['/obstacles/points']]
    assert [set(cloud['id']) for cloud in clouds] == [{o.id for o in some} for some in sure]
    assert [msg.polygon.id for msg in messages['/obstacles/polygons']] == [
        o.id for some in sure for o in some]
    pair = fields.correspondences_from_message(messages['/correspondences'][2])
    np.testing.assert_array_equal(pair.x_prev, steps[2].correspondences.x_prev)


def test_walls_that_are_only_kept_cost_a_message_once(tmp_path, rng, monkeypatch):
    """A map keeps 200 that the filter has given up; each picture's message names all of them."""
    walls = tuple(replace(made_up.map_plane(rng), id=id_) for id_ in range(7))
    made = []
    make = fields.map_plane_to_fields
    monkeypatch.setattr(fields, 'map_plane_to_fields', lambda *args: (
        made.append(args[0].id) or make(*args)))
    with ResultsWriter(tmp_path) as writer:
        for k in range(21):  # 2.1 s
            step = made_up_step(rng, k)
            step.scene = replace(step.scene, planes=walls)
            writer.write(step)
    assert made == list(range(7))
    reader = BagReader(tmp_path / 'results.mcap')
    assert {len(msg.planes) for _, msg in reader.messages(['/planes/map'])} == {7}
    assert [len(list(reader.messages([topic]))) for topic in (
        '/planes/map', '/planes/map_markers', '/path')] == [21, 3, 3]


def test_the_bag_begins_with_the_calibration(tmp_path, rng):
    camera = Camera(640, 480, np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]))
    with ResultsWriter(tmp_path, camera=camera) as writer:
        writer.write(made_up_step(rng, 0))
        writer.write(made_up_step(rng, 1))
    reader = BagReader(tmp_path / 'results.mcap')
    [(_, info)] = reader.messages(['/camera_info'])
    assert (info.width, info.height, info.k[0], info.k[2]) == (640, 480, 500.0, 320.0)


def test_the_transform_comes_before_what_needs_it(out):
    reader = BagReader(out / 'results.mcap')
    order = [raw.topic for raw, _ in reader.messages(['/tf', '/odometry'])]
    assert order == ['/tf', '/odometry'] * 2


def test_a_path_is_written_now_and_then_and_is_whole(tmp_path, rng):
    with ResultsWriter(tmp_path) as writer:
        for k in range(25):
            writer.write(made_up_step(rng, k))
    paths = [msg for _, msg in BagReader(tmp_path / 'results.mcap').messages(['/path'])]
    assert [len(path.poses) for path in paths] == [1, 11, 21]
    assert paths[2].header.frame_id == 'odom'


def test_files_of_an_earlier_run_go_when_a_new_one_starts(out, steps):
    writer = ResultsWriter(out)
    writer.write(steps[1])
    assert not {'labels.npz', 'map.json', 'results.mcap', 'summary.json'} & {
        path.name for path in out.iterdir()}
    writer.close()


def test_two_runs_never_write_into_one_folder_at_once(out, steps):
    with ResultsWriter(out) as writer:
        writer.write(steps[1])
        with pytest.raises(UsageError, match='another run writes into .*out; wait for it, or'):
            ResultsWriter(out)
    assert len(read_trajectory(out / 'trajectory.tum')) == 2
    ResultsWriter(out).close()


def test_no_run_begins_while_the_files_of_another_are_read(out):
    with ExitStack() as held:
        ResultsWriter(out, held=held).close()
        with pytest.raises(UsageError, match='another run writes into'):
            ResultsWriter(out)
    ResultsWriter(out).close()
    assert not list(out.glob('.*'))


def test_a_run_that_is_killed_keeps_no_other_out(out):
    code = f'''
import os, signal
from mv_slapse.storage.results import ResultsWriter
writer = ResultsWriter({str(out)!r})
os.kill(os.getpid(), signal.SIGKILL)
'''
    done = subprocess.run([sys.executable, '-c', code])
    assert done.returncode == -9
    assert (out / 'trajectory.tum.part').exists()
    ResultsWriter(out).close()


def test_an_interrupted_run_leaves_valid_files(tmp_path, steps):
    def interrupted_run():
        with ResultsWriter(tmp_path) as writer:
            for step in steps[:2]:
                writer.write(step)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted_run()
    assert len(read_trajectory(tmp_path / 'trajectory.tum')) == 2
    assert not BagReader(tmp_path / 'results.mcap').is_cut
    assert (tmp_path / 'labels.npz').exists()
    assert not (tmp_path / 'summary.json').exists()


def test_rows_are_on_disk_before_the_run_ends(tmp_path, steps):
    writer = ResultsWriter(tmp_path)
    writer.write(steps[1])
    assert len(read_trajectory(tmp_path / 'trajectory.tum.part')) == 2
    assert len(read_table(tmp_path / 'obstacles.csv.part', OBSTACLES_HEADER)['id']) == 1
    writer.close()
    assert not list(tmp_path.glob('*.part'))


def test_a_place_that_cannot_be_written_is_named(tmp_path):
    (tmp_path / 'file').touch()
    with pytest.raises(UsageError, match='file/out cannot be written.*-o'):
        ResultsWriter(tmp_path / 'file' / 'out')


@pytest.mark.parametrize('limit', [300, 3_000, 20_000])
def test_a_full_disk_is_told_with_what_there_is(tmp_path, limit):
    """A limit on the size of files stands for the disk: writing fails elsewhere each time."""
    code = f'''
import resource, signal, sys
import numpy as np
from mv_slapse.errors import UnusableOutput
from mv_slapse.storage.results import ResultsWriter
from storage.test_results import made_up_step
rng = np.random.default_rng(0)
steps = [made_up_step(rng, k) for k in range(40)]
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
writer = ResultsWriter({str(tmp_path / 'out')!r})
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
try:
    with writer:
        for step in steps:
            writer.write(step)
except UnusableOutput as error:
    print(error)
    sys.exit(error.exit_code)
'''
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True,
                          env={**os.environ, 'PYTHONPATH': os.pathsep.join(sys.path)})
    assert done.returncode == 3, done.stderr
    assert 'cannot be written: File too large' in done.stdout
    left = {path.name for path in (tmp_path / 'out').iterdir() if path.is_file()}
    named = done.stdout.partition('are whole: ')[2].partition(';')[0].split(', ')
    assert {*named} - {'none'} == {name for name in left if not name.endswith('.part')}
