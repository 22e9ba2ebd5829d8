"""Estimate of a moving plane: exact scenes, noise, outliers, gauge, time to contact."""

from drawn_movers import CAMERA_HEIGHT, Drive, DT, K, Mover
from formulas import fit_moving_plane, time_to_contact
from mv_slapse.movers.moving_plane import fit_surfaces, homography, Regions, View
from mv_slapse.records import ScalePrior
import numpy as np
import pytest

CARS = {
    'slower': Drive((Mover(1, (0, 12), (0, 6)),)),
    'oncoming': Drive((Mover(1, (-3, 16), (0, -8)),)),
    'turned': Drive((Mover(1, (-3, 15), (1, 0), size=(6, 2), yaw=0.7),), omega=0.2),
    'crossing': Drive((Mover(1, (-4, 15), (6, 0), size=(4, 1.5)),), speed=0.0),
}


class Case:
    """Vectors of the mover of a drive at 0.5 s, in units of the baseline."""

    def __init__(self, drive, noise=0.0, rng=None):
        self.drive, self.mover, self.time = drive, drive.movers[0], 0.5
        self.R, t = drive.motion(self.time - DT, self.time)
        baseline = np.linalg.norm(t)
        self.unit = baseline if baseline > 0 else 1.0
        self.t = t / self.unit
        self.x, self.exact, self.depth = drive.blocks(self.mover, self.time - DT, self.time)
        self.x_prev = self.exact + (noise * rng.normal(size=self.exact.shape) if noise else 0)
        self.ground = np.array([0, -1, 0]) / CAMERA_HEIGHT * self.unit
        self.sigma = np.full(len(self.x), max(noise, 0.01))

    def fit(self, ground=True, **changed):
        columns = {'x_prev': self.x_prev, 'sigma': self.sigma, **changed}
        return fit_moving_plane(self.x, columns['x_prev'], columns['sigma'],
                                np.full(self.x.shape, 16), K, self.R, self.t,
                                self.ground if ground else None)

    def truth(self):
        """Return plane and t_d in units of the baseline."""
        R, t = self.drive.pose(self.time)
        n, d = self.mover.plane(self.time)
        plane = R.T @ n / (d + n @ t)
        return np.r_[plane * self.unit,
                     -R.T @ self.mover.speed(self.time) * DT / self.unit]

    def contact(self, centre):
        """Return the exact time to contact of the surface on the ray of a centre."""
        R, t = self.drive.pose(self.time)
        n, d = self.mover.plane(self.time)
        depth = -(d + n @ t) / (n @ R @ [*centre, 1])
        before = self.drive.pose(self.time - DT)[1]
        rate = (R.T @ (self.mover.speed(self.time) - (t - before) / DT))[2]
        return depth / -rate if rate < -1e-9 else np.inf


@pytest.fixture(params=CARS, ids=str)
def case(request):
    return Case(CARS[request.param])


def test_product_is_exact_without_noise(case):
    truth = case.truth()
    fit = case.fit()
    R, x = case.R, np.c_[case.x, np.ones(len(case.x))]
    x_prev = x @ homography(fit.product, K, R).T
    np.testing.assert_allclose(x_prev[:, :2] / x_prev[:, 2:], case.exact, atol=0.02)
    np.testing.assert_allclose(fit.product @ [*fit.centre, 1],
                               np.outer(case.t - truth[3:], truth[:3]) @ [*fit.centre, 1],
                               atol=2e-4)


def test_plane_and_displacement_are_right_along_all_but_the_gauge(case):
    fit, truth = case.fit(), case.truth()
    gauge = np.r_[fit.plane, case.t - fit.t_d]
    scale = (truth[:3] @ fit.plane) / (fit.plane @ fit.plane)
    assert scale == pytest.approx(1, abs=0.2)
    moved = np.r_[fit.plane * scale, case.t - (case.t - fit.t_d) / scale]
    np.testing.assert_allclose(moved, truth, atol=2e-3 * np.linalg.norm(gauge))


def test_ground_contact_settles_the_gauge_within_its_sigma(case):
    fit, truth = case.fit(), case.truth()
    error = np.log(np.linalg.norm(truth[:3]) / np.linalg.norm(fit.plane))
    direction = -fit.plane / np.linalg.norm(fit.plane)
    sigma = np.sqrt(direction @ fit.covariance[:3, :3] @ direction) / np.linalg.norm(fit.plane)
    assert fit.scale_prior is ScalePrior.GROUND_CONTACT
    assert 0.02 < sigma < 0.25
    assert abs(error) < 2.5 * sigma


def test_covariance_is_long_along_the_gauge(case):
    fit = case.fit()
    along = np.r_[fit.plane, case.t - fit.t_d]
    values, vectors = np.linalg.eigh(fit.covariance)
    assert abs(vectors[:, -1] @ along) / np.linalg.norm(along) > 0.95
    assert values[-1] > 20 * values[-2]


def test_without_ground_the_smallest_displacement_counts(case):
    fit = case.fit(ground=False)
    assert fit.scale_prior is ScalePrior.SMALLEST_MOTION
    np.testing.assert_allclose(fit.product @ [*fit.centre, 1],
                               case.fit().product @ [*fit.centre, 1], atol=1e-3)
    relative, t = case.t - fit.t_d, case.t
    nearest = (relative @ t) / (relative @ relative)
    if 3 < -nearest / (fit.plane @ [*fit.centre, 1]) < 60:
        assert nearest == pytest.approx(1, abs=1e-6)


def test_a_smallest_displacement_has_a_wide_covariance(case):
    fit, sure = case.fit(ground=False), case.fit()
    share = [np.sqrt(np.trace(f.covariance[:3, :3])) / np.linalg.norm(f.plane)
             for f in (fit, sure)]
    assert share[0] > 0.9
    assert share[0] > 4 * share[1]


def test_time_to_contact_is_the_exact_one_at_any_scale(case):
    for fit in (case.fit(), case.fit(ground=False)):
        found, variance = time_to_contact(fit.closing, fit.closing_variance, DT)
        expected = case.contact(fit.centre)
        if np.isinf(expected):
            assert abs(fit.closing) < 1e-4
        else:
            assert found == pytest.approx(expected, rel=0.01)
            assert np.sqrt(variance) < 0.05 * found


def test_receding_surface_has_no_contact():
    assert time_to_contact(-0.1, 0.01, 0.1) == (np.inf, np.inf)
    assert time_to_contact(0.0, 0.01, 0.1) == (np.inf, np.inf)


def test_time_to_contact_carries_the_variance_of_the_closing():
    tau, variance = time_to_contact(0.02, 1e-6, 0.1)
    assert tau == pytest.approx(5.0)
    by_closing = (time_to_contact(0.0201, 0, 0.1)[0] - time_to_contact(0.0199, 0, 0.1)[0]) / 2e-4
    assert variance == pytest.approx(by_closing**2 * 1e-6, rel=1e-3)


def test_noise_leads_to_errors_that_the_covariance_expects(case, rng):
    squares = []
    for _ in range(60):
        noisy = Case(case.drive, 0.3, rng)
        fit = noisy.fit()
        error = fit.product @ [*fit.centre, 1] - case.fit().product @ [*fit.centre, 1]
        squares.append(error[2]**2 / fit.closing_variance)
    assert 0.4 < np.mean(squares) < 2.2


def test_third_of_wrong_vectors_does_not_matter(case, rng):
    noisy = Case(case.drive, 0.3, rng)
    wrong = rng.permutation(len(noisy.x))[:len(noisy.x) // 3]
    x_prev = noisy.x_prev.copy()
    x_prev[wrong] += rng.choice([-1, 1], (len(wrong), 2)) * rng.uniform(6, 16, (len(wrong), 2))
    fit, clean = noisy.fit(x_prev=x_prev), noisy.fit()
    assert not np.any(fit.inlier[wrong])
    sigma = np.sqrt(clean.closing_variance)
    assert abs(fit.closing - clean.closing) < 3 * sigma


def test_regions_fitted_together_are_as_fitted_alone(rng):
    cases = [Case(CARS['slower'], 0.3, rng), Case(CARS['oncoming'], 0.3, rng)]
    x = np.concatenate([case.x for case in cases])
    both = fit_surfaces(Regions(
        x, np.concatenate([case.x_prev for case in cases]), np.full(len(x), 0.3),
        np.array([0, len(cases[0].x)])), View(K, cases[0].R, cases[0].t), cases[0].ground)
    for i, case in enumerate(cases):
        fit = case.fit()
        np.testing.assert_allclose(both.centre[i], fit.centre)
        np.testing.assert_allclose(both.theta[i, :3],
                                   -fit.product @ [*fit.centre, 1], rtol=1e-2, atol=1e-4)
        assert both.covariance[i, 2, 2] == pytest.approx(fit.closing_variance, rel=0.02)


def test_few_or_contradicting_vectors_give_nothing(rng):
    case = Case(CARS['slower'], 0.3, rng)
    assert fit_moving_plane(case.x[:3], case.x_prev[:3], case.sigma[:3], np.full((3, 2), 16), K,
                            case.R, case.t) is None
    scattered = case.x_prev + rng.uniform(-30, 30, case.x_prev.shape)
    assert case.fit(x_prev=scattered) is None


def test_small_region_keeps_its_plane_upright(rng):
    drive = Drive((Mover(1, (0, 22), (0, 8)),))
    case = Case(drive, 0.3, rng)
    assert 6 <= len(case.x) <= 12
    normal = case.fit().plane / np.linalg.norm(case.fit().plane)
    assert abs(normal[1]) < 0.3
