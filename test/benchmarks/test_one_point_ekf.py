"""The 1-point RANSAC EKF: its derivatives, wrong matches, and drives with known truth."""

from mv_slapse.evaluation.trajectory import align
from mv_slapse.geometry import rotation
from mv_slapse.simulation.render import Renderer
from mv_slapse.simulation.street import Street, StreetSettings
import numpy as np
from one_point_ekf import drive, OnePointEkf
import pytest

K = np.array([[500.0, 0, 319.5], [0, 510, 239.5], [0, 0, 1]])
STEP = np.array([0.02, -0.01, 0.08])


@pytest.fixture
def ekf():
    found = OnePointEkf(K)
    found.R, found.r = rotation.exp(np.array([0.1, -0.3, 0.05])), np.array([0.2, 0.1, -0.3])
    found.add(np.array([[100.0, 50], [300, 400], [620, 240]]))
    found.points[:, 5] = 0.3, 1.0, 0.05
    found.R, found.r = found.R @ rotation.exp(np.array([0.01, 0.03, 0.0])), found.r + 0.3
    return found


def test_a_new_point_is_seen_where_it_was_seen():
    ekf = OnePointEkf(K)
    ekf.R, ekf.r = rotation.exp(np.array([0.1, -0.3, 0.05])), np.ones(3)
    x = np.array([[100.0, 50], [300, 400]])
    ekf.add(x)
    there, camera, point = ekf.project()
    np.testing.assert_allclose(there, x, atol=1e-9)
    # ... for sure, but for its own pixel's error, whatever the pose and the depth are
    ekf.P[:6, :6] += 0.01 * np.eye(6)
    H = ekf._by_state(camera, point, np.array([0]))
    fresh = OnePointEkf(K)
    fresh.R, fresh.r, fresh.P[:6, :6] = ekf.R, ekf.r, 0.01 * np.eye(6)
    fresh.add(x)
    np.testing.assert_allclose(H @ fresh.P @ H.T, np.eye(2), atol=1e-6)


def test_derivatives_are_those_of_the_projection(ekf):
    x, camera, point = ekf.project()
    for k in range(12):
        step = np.zeros(12 + 18)
        if k < 6:
            step[k] = 1e-6
        else:
            step[12 + k - 6:: 6] = 1e-6
        numeric = (ekf.project(ekf._moved(step)[:3])[0] - x) / 1e-6
        analytic = camera[:, :, k] if k < 6 else point[:, :, k - 6]
        np.testing.assert_allclose(numeric, analytic, rtol=1e-3, atol=1e-2)


def test_a_way_among_points_is_found_despite_wrong_matches():
    rng = np.random.default_rng(0)
    X = rng.uniform([-3, -2, 1.0], [3, 2, 8.0], (60, 3))
    ekf, held, wrong = OnePointEkf(K), [], rng.random((20, 60)) < 0.2
    turn, places = np.array([0.0, 0.004, 0.0]), []
    for i in range(20):
        R, r = rotation.exp(i * turn), i * STEP
        x = (X - r) @ R @ K.T
        x = x[:, :2] / x[:, 2:] + rng.normal(0, 0.3, (60, 2))
        if i:
            shown = x + wrong[i][:, None] * rng.choice([-1, 1], (60, 2)) * rng.uniform(
                8, 30, (60, 2))
            shown[X[:, 2] < r[2] + 0.5] = np.nan
            ekf.predict()
            held.append(ekf.step(shown))
        else:
            ekf.add(x)
        places.append((ekf.r.copy(), r))
    found, true = (np.array(one) for one in zip(*places, strict=True))
    found, true = found[8:], true[8:]  # at first it knows of no motion
    aligned = align(found, true).apply(found)
    assert np.linalg.norm(aligned - true, axis=1).max() < 0.02 * np.linalg.norm(true[-1])
    assert rotation.angle(ekf.R.T @ rotation.exp(19 * turn)) < 0.005
    held, wrong, far = np.array(held)[5:], wrong[6:], X[:, 2] > 2.5
    assert np.mean(held[:, far][wrong[:, far]]) < 0.05
    assert np.mean(held[:, far][~wrong[:, far]]) > 0.75
    assert np.linalg.eigvalsh(ekf.P).min() > -1e-9


def test_one_point_tells_the_turn_of_all_where_most_are_wrong_by_the_prediction():
    rng, ekf = np.random.default_rng(0), OnePointEkf(K)
    ekf.add(rng.uniform([20, 20], [620, 460], (40, 2)))
    ekf.points[:, 5] = 1e-3  # far: only a turn moves them
    ekf.P[3:6, 3:6] = 0.03**2 * np.eye(3)
    seen = ekf.project((rotation.exp(np.array([0.02, 0.03, 0.0])), ekf.r, ekf.points))[0]
    seen[:15] = ekf.project()[0][:15]  # as if nothing had turned
    held = ekf.step(seen)
    assert held[15:].all()
    assert not held[:15].any()
    assert rotation.angle(ekf.R.T @ rotation.exp(np.array([0.02, 0.03, 0.0]))) < 2e-3


def test_deleted_points_leave_the_state(ekf):
    ekf.delete(np.array([False, True, False]))
    assert ekf.points[:, 5].tolist() == [0.3, 0.05]
    assert ekf.P.shape == (24, 24)


def test_a_drive_is_found_in_pictures():
    street = Street(StreetSettings(n_frames=18, fps=15.0, width=320, height=240, focal=250.0,
                                   movers=()))
    poses = drive((frame.image for frame in Renderer(street).frames()), street.camera.K)
    found = np.array([pose.t for pose in poses])
    true = np.array([street.pose(i)[1] for i in range(18)])
    way = np.linalg.norm(true[-1])
    off = np.linalg.norm(align(found, true).apply(found) - true, axis=1)
    assert off.mean() < 0.04 * way
    assert all(rotation.angle(pose.R.T @ street.pose(pose.index)[0]) < 0.02 for pose in poses)
