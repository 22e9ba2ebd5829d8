"""The benchmark runs, and its figures hang together; how fast anything is, is not tested."""

import importlib.util
import json
from pathlib import Path
import sys

import pytest

SCRIPT = Path(__file__).resolve().parents[2] / 'benchmarks' / 'speed.py'


@pytest.fixture(scope='module')
def speed():
    spec = importlib.util.spec_from_file_location('speed', SCRIPT)
    module = importlib.util.module_from_spec(spec)
    sys.modules['speed'] = module  # where dataclasses look up their annotations
    spec.loader.exec_module(module)
    yield module
    del sys.modules['speed']


def test_a_rendered_street_is_measured_in_each_encoding(speed, capsys):
    assert speed.main(['--rendered', '--frames', '14', '--repeat', '1', '--json']) == 0
    measured = json.loads(capsys.readouterr().out)['speeds']
    assert [m['video'] for m in measured] == [f'street/{name}' for name in speed.RENDERED]
    for one in measured:
        stages = {stage['name']: stage for stage in one['stages']}
        plain = stages['plain decoding']
        assert plain['ratio'] == 1
        assert one['frames'] == 14
        assert one['pairs'] > 0
        for stage in stages.values():
            assert stage['ratio'] == pytest.approx(stage['ms_per_frame'] / plain['ms_per_frame'])
        assert stages['all']['ms_per_frame'] > stages['extraction']['ms_per_frame'] > 0


def test_the_table_has_a_line_for_each_stage(speed):
    stages = (speed.Stage('plain decoding', 2.0, 1.0), speed.Stage('extraction', 5.0, 2.5))
    lines = speed.text([speed.Speed('a/b.mpg', 640, 480, 9, 3, stages)]).splitlines()
    assert lines[0] == 'a/b.mpg: 640x480, 9 frames, 3 key frame pairs'
    assert '2.00 ms a frame' in lines[1]
    assert '2.50 x plain decoding' in lines[2]
