"""A state that has lost its heading begins anew, and says as much."""

from copy import deepcopy

from mv_slapse.filters import scene_gauge, scene_state
from mv_slapse.filters.scene_state import GAUGE
from mv_slapse.geometry import rotation
import numpy as np
import pytest
from scene_drive import between_two_poses


@pytest.fixture
def state(rng):
    state = between_two_poses(rng)
    state.velocity = rng.normal(0, 5, 3)
    A = rng.normal(size=(state.size, state.size))
    state.error.P = 0.01 * A @ A.T
    state.error.lasting = 0.1 * rng.normal(size=state.error.lasting.shape)
    return state


def test_a_heading_is_vague_beyond_a_fifth_of_a_radian(state):
    at = state.at('current').start
    for sigma, vague in ((0.19, False), (0.21, True)):
        state.error.P[at:at + 3, at:at + 3] = np.diag([0.01, sigma, 0.01])**2
        assert scene_gauge.is_vague(state) is vague


def test_the_pose_is_as_uncertain_as_before_and_nothing_random_is_left_of_it(state):
    cur, before = state.at('current'), state.error.total
    scene_gauge.begin_anew(state)
    np.testing.assert_allclose(state.error.total[cur, cur], before[cur, cur], atol=1e-12)
    assert not state.P[cur].any()
    om = state.at('omega')
    np.testing.assert_array_equal(state.P[om, om], before[om, om])


def test_what_lasts_turns_and_shifts_all_that_follows(state):
    """Against the same state, turned about its place and shifted, and driven on."""
    scene_gauge.begin_anew(state)
    size = 1e-6
    for k in range(6):
        column = state.error.lasting[state.at('current'), GAUGE][:, k]
        turn = rotation.exp(state.current.R @ column[:3] * size)
        other = deepcopy(state)
        other.current.R = turn @ state.current.R
        other.current.t = state.current.t + size * column[3:]
        other.velocity = turn @ state.velocity
        here = deepcopy(state)
        for one in (here, other):
            scene_state.propagate(one, 0.3, 0.1, 0.1)
        e = here.error_to(other)
        lasting = here.error.lasting[:, GAUGE][:, k]
        for name in ('previous', 'current'):
            np.testing.assert_allclose(e[here.at(name)] / size, lasting[here.at(name)], atol=1e-4)
