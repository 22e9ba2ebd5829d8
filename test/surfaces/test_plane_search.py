"""Stationary planes: a house before the next one, seen twice."""

from dataclasses import replace

from mv_slapse.config import ExtractionSettings
from mv_slapse.surfaces import plane_search
from mv_slapse.surfaces.plane_track import KnownPlanes
import numpy as np
import pytest
from walls import UP, WALLS, walls

NONE = KnownPlanes.none()
RULES = ExtractionSettings(radius=96.0, max_uncertainty=0.12)


def find(depths, known=NONE, free=None, rules=RULES, room=8, next_id=0):
    free = np.ones(len(depths), bool) if free is None else free
    return plane_search.stationary_planes(depths, free, known, UP, rules, (room, next_id))


def often(rng, times=2, next_id=0):
    """Return the planes of a view that is seen some times, and the surfaces of its blocks."""
    known = NONE
    for _ in range(times):
        depths, surface = walls(rng)
        fits, known = find(depths, known, next_id=next_id)
        next_id = max([next_id - 1, *known.id]) + 1
    return fits, known, surface


def test_each_wall_is_found_and_none_is_mixed(rng):
    fits, _, surface = often(rng, 5)
    shown = [np.bincount(surface[fit.member], minlength=3) for fit in fits]
    assert {int(np.argmax(counts)) for counts in shown} == {0, 1, 2}
    assert all(counts.max() > 0.75 * counts.sum() for counts in shown)


def test_normal_and_depth_are_right_within_the_noise(rng):
    fits, _, surface = often(rng)
    for fit in fits:
        true = WALLS[np.argmax(np.bincount(surface[fit.member]))]
        length = np.linalg.norm(fit.plane)
        assert fit.plane @ true / length / np.linalg.norm(true) > np.cos(np.radians(8))
        off = fit.plane - true
        assert off @ np.linalg.solve(fit.covariance, off) < 16


def test_one_pair_confirms_nothing(rng):
    fits, known = find(walls(rng)[0])
    assert fits == []
    assert len(known) >= 2
    assert np.all((known.id == -1) & (known.seen == 1))


def test_a_plane_is_reported_once_it_is_well_known(rng):
    known, reported = NONE, False
    strict = replace(RULES, max_uncertainty=0.05)
    for _ in range(8):
        fits, known = find(walls(rng)[0], known, rules=strict)
        named = {fit.id for fit in fits}
        assert np.all(np.isin(known.id, list(named)) | (known.missed > 0) | (known.seen < 2)
                      | (known.spread >= 0.05))
        reported |= bool(fits)
    assert reported


def test_names_begin_at_the_next_id_and_last(rng):
    fits, known, _ = often(rng, next_id=7)
    assert sorted(fit.id for fit in fits) == list(range(7, 7 + len(fits)))
    again, _ = find(walls(rng)[0], known, next_id=50)
    shared = {fit.id for fit in fits} & {fit.id for fit in again}
    assert len(shared) >= len(fits) - 1
    assert all(fit.id in shared or fit.id >= 50 for fit in again)


def test_no_block_is_in_two_planes(rng):
    fits, _, _ = often(rng)
    assert np.sum([fit.member for fit in fits], axis=0).max() == 1


def test_a_plane_keeps_to_free_blocks(rng):
    depths, surface = walls(rng)
    free = surface != 0
    fits, _ = find(depths, find(depths, free=free)[1], free=free)
    assert fits
    assert not any(fit.member[~free].any() for fit in fits)


def test_a_block_away_from_a_plane_is_not_its_member(rng):
    depths, known = walls(rng)[0], find(walls(rng)[0])[1]
    depths.rho[::7] *= 1.5
    fits, _ = find(depths, known)
    assert fits
    assert not any(fit.member[::7].any() for fit in fits)


def test_depths_at_random_make_no_plane(rng):
    known = NONE
    for _ in range(3):
        depths, _ = walls(rng)
        depths.rho[:] = rng.uniform(0.05, 0.3, len(depths))
        fits, known = find(depths, known)
        assert fits == []


def test_blurred_blocks_make_no_plane(rng):
    depths, _ = walls(rng, 0.1)
    fits, known = find(depths, find(depths)[1])
    assert (fits, len(known)) == ([], 0)


def test_a_wall_of_few_macroblocks_is_none(rng):
    depths, surface = walls(rng)
    small = np.flatnonzero(surface == 0)[:19]
    free = np.isin(np.arange(len(depths)), small)
    assert find(depths, find(depths, free=free)[1], free=free)[0] == []


def test_small_partitions_count_as_their_macroblock(rng):
    known = NONE
    for _ in range(3):
        depths, surface = walls(rng)
        few = np.flatnonzero((surface == 2) & (depths.x[:, 1] < 24))
        four = depths[np.repeat(few, 4)]
        four.rho[:] *= 1 + 0.025 * rng.normal(size=len(four))
        fits, known = find(four, known)
        assert fits == []


def test_a_hidden_plane_is_remembered(rng):
    fits, known, surface = often(rng)
    gone = fits[0].id
    _, known = find(walls(rng)[0], known, free=~fits[0].member & (
        surface != np.argmax(np.bincount(surface[fits[0].member]))), next_id=50)
    assert known.missed[known.id == gone] == [1]


@pytest.mark.parametrize('room', [0, 1])
def test_no_more_planes_are_looked_for_than_there_is_room_for(rng, room):
    assert len(find(walls(rng)[0], room=room)[1]) <= room


def test_the_same_blocks_give_the_same_planes(rng):
    depths, _ = walls(rng)
    (_, a), (_, b) = find(depths), find(depths)
    np.testing.assert_array_equal(a.plane, b.plane)


def test_a_plane_is_as_dense_outside_an_undistorted_picture_as_in_it(rng):
    """A fisheye's blocks lie hundreds of pixels to the left of the picture and above it."""
    depths, _ = walls(rng)
    (_, inside), (_, outside) = find(depths), find(replace(depths, x=depths.x - (1600, 800)))
    np.testing.assert_array_equal(inside.plane, outside.plane)
    assert len(inside) >= 2
