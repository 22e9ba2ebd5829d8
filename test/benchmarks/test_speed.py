"""The benchmark runs, and its figures hang together; how fast anything is, is not tested."""

import json

import pytest
import speed


@pytest.fixture(scope='module')
def made(tmp_path_factory):
    """Return the page and the times of a short run."""
    folder = tmp_path_factory.mktemp('speed')
    assert speed.main(['--quick', '-o', str(folder / 'page.md'),
                       '--json', str(folder / 'times.json')]) == 0
    return (folder / 'page.md').read_text(), json.loads((folder / 'times.json').read_text())


def test_a_street_is_measured_in_each_encoding(made):
    measured = made[1]['clips']
    assert [one['encoding'] for one in measured] == list(speed.ENCODINGS)
    for one in measured:
        turn, = one['turns']
        assert one['frames'] == 26
        assert one['pairs'] > 0
        assert one['blocks'] > 20
        assert turn['steps'] == pytest.approx(
            turn['extraction'] + turn['scene filter'] + turn['tracker'], rel=0.1)
        assert turn[speed.OURS] == pytest.approx(turn['correspondences'] + turn['steps'])
        parts = sum(turn[part] for part in speed.PARTS)
        assert 0 < turn['writing'] < turn['writing'] + parts < turn[speed.WRITING]
        assert all(turn[name] > 0 for name in (speed.BARE, speed.ORB, speed.CORNERS,
                                               speed.FEATURES, *speed.PARTS))
        assert one['ate'][speed.OURS] < 5


def test_the_page_has_what_is_asked(made):
    page, times = made
    turn = times['clips'][0]['turns'][0]
    ratio = f'{turn[speed.OURS] / turn[speed.ORB]:.2f}'
    assert f'| street, 640×480, MPEG-2, B: ours, all ÷ ORB | {ratio} | {ratio} | {ratio} |' in page
    assert 'at commit' in page


def test_ratios_are_of_one_turn():
    turns = [{'a': 1.0, 'b': 2.0}, {'a': 9.0, 'b': 3.0}, {'a': 4.0, 'b': 4.0}]
    one = speed.Measured('', '', 1, 1, 1, 1, 1, 1.0, turns, {})
    assert one.ratios('a', 'b') == [0.5, 1.0, 3.0]
    assert one.ms('a') == 4.0


@pytest.mark.parametrize('path', speed.PARTS.values())
def test_each_part_is_where_the_table_says(path):
    holder, name = speed.place(path)
    assert callable(getattr(holder, name))
