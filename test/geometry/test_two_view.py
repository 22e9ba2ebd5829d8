"""Normal equations of a pair against the numerical gradient and Hessian of their cost."""

from canyon import CANYON, K, motion, MOTIONS, SKY, views
import formulas
from kernels.two_view_reference import plane_transfer
from mv_slapse.geometry import rotation, two_view
from mv_slapse.geometry.camera import to_rays
from numeric import jacobian
import numpy as np
import pytest

WALL = 1


@pytest.fixture(params=MOTIONS)
def noisy(rng, request):
    return views(*motion(request.param), rng, 0.5, 0.2)


@pytest.fixture
def exact():
    return views(*motion('ahead'))


def moved(scene, p):
    """Return motion, and planes if p holds some, moved by (w, t, planes)."""
    return rotation.exp(p[:3]) @ scene.R, scene.t + p[3:6]


def epipolar_terms(pair, R, t, width):
    return formulas.normal_equations(pair, R, t, [], np.full(len(pair), -1), 0.0, width)


def plane_terms(pair, R, t, plane, relief, width, dependence=(1.0, 1.0)):
    return formulas.normal_equations(pair, R, t, [plane], np.zeros(len(pair), int), relief, width,
                                     dependence=dependence)


def test_a_mask_selects_all_columns(exact):
    mask = exact.surface == WALL
    part = exact.pair[mask]
    assert len(part) == mask.sum()
    np.testing.assert_array_equal(part.rays_cur, exact.pair.rays_cur[mask])
    np.testing.assert_array_equal(part.rays_prev, exact.pair.rays_prev[mask])
    np.testing.assert_array_equal(part.x_prev, exact.x_prev[mask])
    np.testing.assert_array_equal(part.focal, [K[0, 0], K[1, 1]])


def test_epipolar_vector_is_minus_half_the_gradient_of_the_cost(noisy):
    pair = noisy.pair[np.hypot(*(noisy.x_true - noisy.x_cur).T) > 1]
    gradient = jacobian(lambda p: epipolar_terms(pair, *moved(noisy, p), 3.0)[2],
                        np.zeros(6))
    _, b, _ = epipolar_terms(pair, noisy.R, noisy.t, 3.0)
    np.testing.assert_allclose(b, -gradient / 2, rtol=1e-3, atol=1e-4 * np.abs(b).max())


def test_plane_vector_is_minus_half_the_gradient_of_the_cost(noisy):
    pair = noisy.pair[noisy.surface == WALL]

    def cost(p):
        return plane_terms(pair, *moved(noisy, p), CANYON[WALL] + p[6:], 0.0, 3.0)[2]

    _, b, _ = plane_terms(pair, noisy.R, noisy.t, CANYON[WALL], 0.0, 3.0)
    np.testing.assert_allclose(b, -jacobian(cost, np.zeros(9)) / 2, rtol=1e-3,
                               atol=1e-4 * np.abs(b).max())


def test_relief_leaves_the_gradient_that_of_the_cost_with_weights_held(noisy):
    pair, plane, relief = noisy.pair[noisy.surface == WALL], CANYON[WALL], 0.05
    predicted, far = (plane_transfer(pair.rays_cur, K, noisy.R, noisy.t, of)
                      for of in (plane, np.zeros(3)))
    along = relief * (predicted - far)
    W = np.linalg.inv((pair.sigma**2)[:, None, None] * np.eye(2)
                      + along[:, :, None] * along[:, None])

    def cost(p):
        e = pair.x_prev - plane_transfer(pair.rays_cur, K, *moved(noisy, p),
                                                    plane + p[6:])
        m2 = np.einsum('ni,nij,nj->n', e, W, e)
        return np.sum(m2 / (1 + m2 / 9))

    _, b, value = plane_terms(pair, noisy.R, noisy.t, plane, relief, 3.0)
    assert value == pytest.approx(cost(np.zeros(9)))
    np.testing.assert_allclose(b, -jacobian(cost, np.zeros(9)) / 2, rtol=1e-3,
                               atol=1e-4 * np.abs(b).max())


def test_at_exact_data_the_matrix_is_half_the_hessian_of_the_cost(exact):
    pair = exact.pair[exact.surface == WALL]

    def vector(p):
        return plane_terms(pair, *moved(exact, p), CANYON[WALL] + p[6:], 0.0, 3.0)[1]

    A, b, cost = plane_terms(pair, exact.R, exact.t, CANYON[WALL], 0.0, 3.0)
    numerical = -jacobian(vector, np.zeros(9), 1e-9)
    np.testing.assert_allclose(A, numerical, rtol=1e-3, atol=1e-4 * np.abs(A).max())
    assert cost < 1e-12
    np.testing.assert_allclose(b / np.sqrt(np.diag(A)), 0, atol=1e-6)


def test_errors_in_common_take_weight_off_across_and_along_the_line_by_themselves(noisy):
    pair, plane = noisy.pair[noisy.surface == WALL], CANYON[WALL]
    (one, *_), (across, *_), (along, *_), (both, *_) = (
        plane_terms(pair, noisy.R, noisy.t, plane, 0.03, 3.0, dependence)
        for dependence in ((1, 1), (4, 1), (1, 4), (4, 4)))
    np.testing.assert_allclose(both, one / 4, rtol=1e-9)
    np.testing.assert_allclose(across + along, one + both, rtol=1e-6, atol=1e-9 * one.max())


def test_an_offset_is_a_turn_of_all_vectors_as_one_more_unknown(noisy):
    """Its elimination leaves what knows the turn no better than the error that all share."""
    arguments = noisy.pair, noisy.R, noisy.t, CANYON, noisy.surface, 0.03, 3.0
    (A, b, _), sigma = formulas.normal_equations(*arguments), 0.2 / np.mean([K[0, 0], K[1, 1]])
    full = np.block([[A, A[:, :3]], [A[:3], A[:3, :3] + np.eye(3) / sigma**2]])
    left = np.s_[:18]
    A_left, b_left, _ = formulas.normal_equations(*arguments, offset=0.2)
    gain = full[left, 18:] @ np.linalg.inv(full[18:, 18:])
    np.testing.assert_allclose(A_left, A - gain @ full[18:, left], atol=1e-9 * np.abs(A).max())
    np.testing.assert_allclose(b_left, b - gain @ b[:3], atol=1e-9 * np.abs(b).max())
    damped = 1e-6 * np.diag(np.diag(A))  # |t| is not observed
    wider = np.linalg.inv(A_left + damped) - np.linalg.inv(A + damped)
    np.testing.assert_allclose(wider[:3, :3], sigma**2 * np.eye(3), rtol=0.01,
                               atol=0.01 * sigma**2)


def test_a_bias_is_one_more_unknown_along_the_plane(noisy):
    pair, plane, bias = noisy.pair[noisy.surface == WALL], CANYON[WALL], 0.3
    arguments = pair, noisy.R, noisy.t, [plane], np.zeros(len(pair), int), 0.03, 3.0
    A, b, _ = formulas.normal_equations(*arguments)
    A_left, b_left, _ = formulas.normal_equations(*arguments, bias=bias)
    column = A[:, 6:] @ plane  # (1 + s) plane: the derivative by s is that along the plane
    own = plane @ column[6:] + 1 / bias**2
    np.testing.assert_allclose(A_left, A - np.outer(column, column) / own,
                               atol=1e-9 * np.abs(A).max())
    np.testing.assert_allclose(b_left, b - column * (plane @ b[6:]) / own,
                               atol=1e-9 * np.abs(b).max())


def test_a_large_bias_hides_the_planes_scale(noisy):
    pair, plane = noisy.pair[noisy.surface == WALL], CANYON[WALL]
    A, b, _ = formulas.normal_equations(pair, noisy.R, noisy.t, [plane],
                                        np.zeros(len(pair), int), 0.03, 3.0, bias=1e6)
    np.testing.assert_allclose(A[:, 6:] @ plane, 0, atol=1e-6 * np.abs(A).max())
    assert abs(b[6:] @ plane) < 1e-6 * np.abs(b).max()


def test_equations_of_a_pair_are_the_sum_of_its_parts(noisy):
    arguments, dependence = (noisy.R, noisy.t), (5.0, 7.0)
    A, b, cost = formulas.normal_equations(noisy.pair, *arguments, CANYON, noisy.surface, 0.03,
                                           3.0, bias=0.04, dependence=dependence)
    sky = epipolar_terms(noisy.pair[noisy.surface == SKY], *arguments, 3.0)
    A_sum, b_sum, cost_sum = np.zeros((18, 18)), np.zeros(18), sky[2]
    A_sum[:6, :6], b_sum[:6] = sky[0] / 5, sky[1] / 5
    for i, plane in enumerate(CANYON):
        on = noisy.pair[noisy.surface == i]
        A_i, b_i, cost_i = formulas.normal_equations(
            on, *arguments, [plane], np.zeros(len(on), int), 0.03, 3.0, bias=0.04,
            dependence=dependence)
        pick = np.zeros((9, 18))
        pick[:6, :6], pick[6:, 6 + 3 * i:9 + 3 * i] = np.eye(6), np.eye(3)
        A_sum, b_sum, cost_sum = A_sum + pick.T @ A_i @ pick, b_sum + pick.T @ b_i, (
            cost_sum + cost_i)
    np.testing.assert_allclose(A, A_sum, atol=1e-12 * np.abs(A).max())
    np.testing.assert_allclose(b, b_sum, atol=1e-12 * np.abs(b).max())
    assert cost == pytest.approx(cost_sum)


def test_nothing_seen_weighs_nothing():
    empty = two_view.Pair(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0), K)
    A, b, cost = formulas.normal_equations(empty, np.eye(3), np.ones(3), CANYON[:1],
                                           np.zeros(0, int), 0.03, 3.0)
    assert not A.any()
    assert not b.any()
    assert cost == 0


def test_a_wrong_vector_costs_at_most_the_square_of_the_width(exact):
    x_prev = exact.x_prev.copy()
    x_prev[exact.surface == WALL] += [300, 200]
    wrong = two_view.Pair(exact.pair.rays_cur, to_rays(K, x_prev), x_prev, exact.sigma, K)
    count = np.sum(exact.surface == WALL)
    _, _, cost = formulas.normal_equations(wrong, exact.R, exact.t, CANYON, exact.surface, 0.0, 3)
    assert cost == pytest.approx(9 * count, rel=1e-3)
