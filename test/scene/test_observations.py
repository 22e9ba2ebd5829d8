"""What is observed beside correspondences: derivative of each innovation, and its value."""

import formulas
from mv_slapse.scene import observations as scene_observations
from mv_slapse.scene import state as scene_state
from mv_slapse.scene.observations import Kind, linearised, Observation
from mv_slapse.scene.state import AnchoredPlane
from numeric import jacobian
import numpy as np
import pytest
from scene_drive import between_two_poses

ROAD = 4
OBSERVATIONS = {
    'camera height': formulas.camera_height(ROAD, 1.65, 0.03),
    'height wrong for good': formulas.camera_height(ROAD, 1.65, 0.03, 0.02),
    'mounting': Observation(Kind.MOUNTING, 0.01, plane=ROAD),
    'baseline': scene_observations.baseline(3.0, 1e-3),
    'speed wrong for good': scene_observations.baseline(3.0, 0.02, 0.01),
    'level course': Observation(Kind.LEVEL_COURSE, 0.02),
}


@pytest.fixture
def state(rng):
    state = between_two_poses(rng)
    state.depth_scale, state.heave = 0.3, 0.02
    state.add_plane(ROAD, AnchoredPlane(rng.normal(0, 0.3, 3), state.previous.t), np.eye(3))
    return state


@pytest.mark.parametrize('name', OBSERVATIONS)
def test_each_jacobian_is_the_numerical_one_of_its_innovation(state, name):
    observation = OBSERVATIONS[name]
    _, H = linearised(observation, state)
    numerical = -jacobian(lambda e: linearised(observation, state.moved(e))[0],
                          np.zeros(state.size))
    # The mount is a unit vector: an error along itself does not count.
    at, along = state.at('mount'), np.outer(state.mount, state.mount)
    H[:, at] -= H[:, at] @ along
    np.testing.assert_allclose(H, numerical, rtol=1e-5, atol=1e-7)
    assert observation.sigma > 0


def test_innovations_by_hand():
    state = scene_state.start(np.array([0, -1.0, 0]), 1.0, 0.1, 0.05)
    state.current.t = np.array([0, 0.3, 2.0])
    state.add_plane(ROAD, AnchoredPlane(np.array([0, -0.5, 0]), np.array([0, 0.3, 0])), np.eye(3))
    state.depth_scale = 0.5
    innovation = {name: linearised(one, state)[0] for name, one in OBSERVATIONS.items()}
    np.testing.assert_allclose(innovation['camera height'], [1.65 - 2.0])
    state.heave = 0.1
    np.testing.assert_allclose(linearised(OBSERVATIONS['camera height'], state)[0],
                               [1.65 * 1.1 - 2])
    assert OBSERVATIONS['camera height'].lasting.tolist() == [0] * scene_state.N_LASTING
    wrong = np.zeros(scene_state.N_LASTING)
    wrong[scene_state.HEIGHT] = 0.02
    np.testing.assert_array_equal(OBSERVATIONS['height wrong for good'].lasting, wrong)
    faster = np.zeros(scene_state.N_LASTING)
    faster[scene_state.SPEED] = 0.01
    np.testing.assert_array_equal(OBSERVATIONS['speed wrong for good'].lasting, faster)
    np.testing.assert_allclose(innovation['mounting'], 0, atol=1e-12)
    np.testing.assert_allclose(innovation['baseline'], [np.log(3 / np.hypot(0.3, 2))])
    # The camera sinks: its motion t points up against the mount's normal.
    np.testing.assert_allclose(innovation['level course'], [-0.3 / np.hypot(0.3, 2)])
