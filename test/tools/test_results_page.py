import csv
import io

from mv_slapse.tools import results_page
from mv_slapse.tools.results_page import FREE, HEIGHT, Name, name_of, SPEED
import pytest

MEASURED = {
    'kitti00/mpeg2.mpg': {'ate_mean_percent': 0.2, 'cpu_ms': 20.0, 'n_poses': 10},
    'kitti00/h264.mp4': {'ate_mean_percent': 0.4, 'cpu_ms': 30.0, 'n_poses': 10},
    'free scale, kitti00/mpeg2.mpg': {'ate_mean_percent': 0.6, 'cpu_ms': 40.0},
    'street 0/mpeg2.mpg': {'ate_mean_percent': 0.1, 'movers_found': 2, 'movers_total': 3,
                           'movers_due': 3, 'movers_confirmed_in_time': 1, 'cpu_ms': 10.0},
    'street 1/mpeg2.mpg': {'ate_mean_percent': 0.3, 'movers_found': 1, 'movers_total': 1,
                           'movers_due': 2, 'movers_confirmed_in_time': 2, 'cpu_ms': 10.0},
    'moving/seq005_clip01/mpeg2.mpg': {'movers_found': 1, 'movers_total': 2, 'cpu_ms': 50.0},
    'moving/tusimple/mpeg2.mpg': {'error': 'no motion'}}


def lines_below(page, title):
    return page.split(f'## {title}')[1].split('\n## ')[0].splitlines()


@pytest.mark.parametrize(('row', 'name'), [
    ('kitti00/mpeg2.mpg', Name('kitti00', HEIGHT, 'mpeg2')),
    ('speed given, flight, wide lens/mpeg2.mpg', Name('flight, wide lens', SPEED, 'mpeg2')),
    ('kitti00, 2 s lost, free scale/a.mp4', Name('kitti00, 2 s lost', FREE, 'a')),
    ('seq005_clip01, mirrored/mpeg2.mp4', Name('given clips, mirrored', HEIGHT, 'mpeg2')),
    ('moving/car4/mpeg2.mpg', Name('given clips', HEIGHT, 'mpeg2')),
    ('crossing 3/h264_lowlatency.mp4', Name('crossing', HEIGHT, 'h264_lowlatency'))])
def test_a_row_says_what_it_is(row, name):
    assert name_of(row) == name


def test_scenes_of_one_kind_are_one_line_with_median_worst_and_sum():
    page = results_page.page(MEASURED, 'abc')
    position = lines_below(page, 'How far off is the position?')
    assert '| kitti00 | 2 | 0.300 | 0.400 |  |  |  |  |  |' in position
    assert '| kitti00, free scale | 1 | 0.600 | 0.600 |  |  |  |  |  |' in position
    assert '| street | 2 | 0.200 | 0.300 |  |  |  |  |  |' in position
    moving = lines_below(page, 'Is what moves called moving, and nothing else?')
    assert '| street | 2 | 3 | 4 |  |  |' in moving
    assert '| given clips, mpeg2 | 1 | 1 | 2 |  |  |' in moving


def test_the_page_says_how_it_was_made():
    assert 'by `make evaluate` at commit abc' in results_page.page(MEASURED, 'abc')
    assert ('by `make evaluate ARGS="--first-seed 100"` at commit abc'
            in results_page.page(MEASURED, 'abc', first_seed=100))


def test_ten_lines_say_it_in_short():
    page = results_page.page(MEASURED, 'abc')
    short = [line for line in page.splitlines() if line.startswith('* ')]
    assert len(short) <= 10
    assert any(line.startswith('* Position, free scale: 0.600 %') for line in short)
    assert '* 1 of 2 labelled movers of the given clips are called moving' in page
    assert '* 3 of 5 passages of movers are confirmed within 0.5 s' in page
    assert '* 1 of 7 rows could not be measured.' in short
    assert 'at commit abc' in page


def test_what_fails_is_named():
    fails = lines_below(results_page.page(MEASURED, 'abc'), 'Where does it fail?')
    assert '| moving/tusimple/mpeg2.mpg | no motion |' in fails
    assert fails.index('| free scale, kitti00/mpeg2.mpg | position 0.60 % off |') < fails.index(
        '| kitti00/h264.mp4 | position 0.40 % off |')
    assert '| street 0/mpeg2.mpg | 1 of 3 movers not called moving |' in fails


def test_all_rows_with_all_figures_are_in_the_table():
    rows = list(csv.DictReader(io.StringIO(results_page.rows_as_csv(MEASURED))))
    assert [row['sequence'] for row in rows] == list(MEASURED)
    assert rows[0]['cpu_ms'] == '20.0'
    assert rows[3]['n_poses'] == ''
    assert rows[-1]['error'] == 'no motion'
