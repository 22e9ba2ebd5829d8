"""``run --map``: the results in the frame of an earlier run."""

import json

from mv_slapse.config import SceneSettings, Settings
from mv_slapse.storage.camera_info import read_camera
from mv_slapse.storage.tum import read_trajectory
from mv_slapse.tools.run import Options, run
import numpy as np

ENOUGH = 108  # pictures, to beyond where the wall ahead is seen


def test_where_the_planes_are_not_found_again_the_run_says_so(clip, call, tmp_path):
    code, _, _ = call('run', clip.video, '--camera', clip.camera, '--camera-height', 1.65,
                      '--map', clip.out / 'map.json', '-o', tmp_path, '--quiet', '--no-report')
    assert code == 0
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert summary['known_map']['found'] is False
    assert any('are not found again' in warning for warning in summary['warnings'])
    for name in ('trajectory.tum', 'planes.csv', 'obstacles.csv'):
        assert (tmp_path / name).read_bytes() == (clip.out / name).read_bytes()


def test_what_is_no_map_is_refused(clip, call, tmp_path):
    (tmp_path / 'map.json').write_text('[1, 2')
    code, _, error = call('run', clip.video, '--camera', clip.camera, '-o', tmp_path / 'out',
                          '--map', tmp_path / 'map.json', '--quiet')
    assert code == 3
    assert 'is no map of mv_slapse' in error


def test_a_real_street_in_another_encoding_is_found_again(data, tmp_path):
    folder, settings = data / 'kitti00', Settings(scene=SceneSettings(camera_height=1.65))
    camera = read_camera(folder / 'camera.yaml')
    run(folder / 'mpeg2.mpg', camera, settings, tmp_path / 'first',
        Options(max_frames=ENOUGH))
    summary = run(folder / 'h264_lowlatency.mp4', camera, settings, tmp_path / 'again',
                  Options(max_frames=ENOUGH, known_map=tmp_path / 'first' / 'map.json'))
    assert summary.known_map['found'], summary.known_map
    found = read_trajectory(tmp_path / 'again' / 'trajectory.tum')
    first = read_trajectory(tmp_path / 'first' / 'trajectory.tum')
    begin = found.positions[0] - first.positions[0]
    np.testing.assert_allclose(begin, summary.known_map['position'], atol=1e-6)
    assert 0.1 < np.linalg.norm(begin) < 2 * summary.known_map['position_sigma_m'] < 12
    # the map tells the start, the way since then has errors of its own
    at = np.searchsorted(first.stamps, found.stamps[-1])
    end = found.positions[-1] - first.positions[min(at, len(first) - 1)]
    assert np.linalg.norm(end) < 5
