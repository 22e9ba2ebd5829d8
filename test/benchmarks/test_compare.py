"""The comparison: its figures are those of the truth, and its page shows them."""

from dataclasses import replace
from functools import partial

import compare
import compare_page
import departures
from mv_slapse.codec.encoding.encoder import Encoding
from mv_slapse.evaluation.trajectory import epsilon_d
from mv_slapse.records import SegmentKind
from mv_slapse.simulation.street import StreetSettings
from mv_slapse.tools import cases
import numpy as np
import pytest

SMALL = StreetSettings(n_frames=22, width=400, height=304, focal=310.0)


@pytest.fixture(scope='module')
def case(tmp_path_factory):
    folder = tmp_path_factory.mktemp('street')
    found, = cases.encoded({'street 0/mpeg2.mpg': Encoding('mpeg2video', 1, 12)}, folder, 30.0,
                           partial(cases.film, cases.Street(SMALL), folder / 'truth'),
                           cases.Case('', folder, cases.Street(SMALL).camera, 0.0,
                                      folder / 'truth'))
    return found


@pytest.fixture(scope='module')
def rows(case):
    return {('row', 'street 0', method): compare.measured(case, method)
            for method in compare.METHODS}


def test_a_true_way_has_no_error_whatever_its_unit():
    turn = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    poses = [(i * 10**8, np.eye(3), np.array([0.1 * i**2, 0, i])) for i in range(9)]
    truth = compare.as_trajectory(poses)
    half = compare.as_trajectory([(s, R, t / 2) for s, R, t in poses])
    row = compare.way(half, truth, 'first step')
    for name in ('ate_max_percent', 'epsilon_d_percent', 'epsilon_d_by_ratio'):
        assert row[name] == pytest.approx(0, abs=1e-9)
    assert row['scale'] == pytest.approx(2)
    np.testing.assert_allclose(row['path'], row['truth'], atol=1e-9)
    assert compare.way(half, truth, 'metres')['epsilon_d_percent'] == pytest.approx(50)
    turned = compare.as_trajectory([(s, R, turn @ t) for s, R, t in poses])
    assert compare.way(turned, truth, 'metres')['epsilon_d_percent'] > 100
    assert compare.way(replace(half, stamps=half.stamps + 10**12), truth, 'metres')['error']
    assert epsilon_d(half, truth, False) == pytest.approx(0, abs=1e-9)


def test_every_method_finds_a_rendered_way(rows):
    for (_, _, method), row in rows.items():
        assert row['ate_mean_percent'] < (5 if method == '1-point EKF' else 2), method
        assert row['cpu_ms'] > 0
        assert 0 < row['n_poses'] <= row['n_frames'] == 22
    for method in ('ours', 'SLAPSE', 'MVO'):
        assert rows['row', 'street 0', method]['on_one_percent'] > 20


def test_a_larger_threshold_extracts_more_planes_and_worse_ones(case):
    strict, loose = (compare.extraction(case, h) for h in (1.0, 4.0))
    assert 0 < strict['true'] <= strict['planes']
    assert strict['true'] / strict['planes'] > loose['true'] / loose['planes']


def test_the_page_shows_what_was_measured(rows, tmp_path):
    found = rows | {('sweep', 'street 0', 1.0): {'planes': 10, 'true': 9},
                    ('departure', 'Rests', 'rest'): [('walked', '1 m', '0 m')]}
    pages = []
    for name in ('a', 'b'):
        (tmp_path / name).mkdir()
        compare_page.write(tmp_path / name / 'page.md', found, 'head', 'c0ffee')
        pages.append([file.read_bytes() for file in sorted((tmp_path / name).iterdir())])
    assert pages[0] == pages[1]
    text = (tmp_path / 'a' / 'page.md').read_text()
    row = rows['row', 'street 0', 'MVO']
    assert f'{row["ate_mean_percent"]:.2f} ({row["ate_max_percent"]:.2f})' in text
    assert '| printed, ε_h = 1 px | 10 | 90.0 % |' in text
    assert '| Rests | walked | 1 m | 0 m |' in text
    assert 'c0ffee' in text
    assert len(pages[0]) == 3


def test_the_fingerprint_is_that_of_all_but_times():
    row = {('row', 'a', 'ours'): {'cpu_ms': 1.0, 'scale': 2.0}}
    later = {('row', 'a', 'ours'): {'cpu_ms': 3.0, 'scale': 2.0}}
    other = {('row', 'a', 'ours'): {'cpu_ms': 1.0, 'scale': 2.0 + 1e-12}}
    assert compare_page.fingerprint(row) == compare_page.fingerprint(later)
    assert compare_page.fingerprint(row) != compare_page.fingerprint(other)


@pytest.mark.parametrize(('n_b', 'p'), [(1, 0.6), (2, 0.8), (3, 0.5)])
def test_lemma_2_is_the_variance_of_drawn_vectors(n_b, p):
    drawn = departures.drawn_variance(n_b, p, 100_000)
    assert departures.lemma_2(SegmentKind.PP, n_b, p) == pytest.approx(drawn, rel=0.015)
    if n_b == 1:
        assert departures.lemma_2_printed(n_b, p) == pytest.approx(1.295, abs=5e-4)


def test_blocks_of_a_standing_car_are_called_moving_by_the_print_more_than_by_the_package():
    rows = departures.moving_planes()
    for _, printed, ours in rows[:2]:
        assert float(printed.split(', ')[1]) > 3 * float(ours)


def test_two_views_do_not_tell_the_distance_of_a_mover():
    (_, printed, _), = departures.gauge()
    assert float(printed.split(':')[0]) < 1e-9


def test_a_car_that_starts_ahead_is_found_by_the_package_alone(monkeypatch):
    monkeypatch.setattr(departures, 'SEEDS', 1)
    (_, printed, ours), = departures.starting()
    later = [float(part.split(', ')[1]) for part in (*printed.split('; '), ours)]
    assert later[2] > 80
    assert max(later[:2]) < 60
