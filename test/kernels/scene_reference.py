"""The formulas of the scene's kernels in numpy."""

import formulas
from formulas import plane_in_camera_jacobian, relative_motion_jacobian
from kernels.two_view_reference import without_turn
from mv_slapse.geometry import rotation, two_view
from mv_slapse.scene import gauge as scene_gauge
from mv_slapse.scene.observations import linearised
from mv_slapse.scene.state import (
    FOCAL,
    N_LASTING,
    PLACE,
    plane_in_camera,
    relative_motion,
    stretched,
    TURN,
)
import numpy as np
from scipy import ndimage


def observation_jacobian(state, ids):
    """Derivative (6 + 3 P, n) of (w, t, planes in the camera) by the error state."""
    G = np.zeros((6 + 3 * len(ids), state.size))
    G[:6, state.at('previous')], G[:6, state.at('current')] = relative_motion_jacobian(state)
    for i, id_ in enumerate(ids):
        row = slice(6 + 3 * i, 9 + 3 * i)
        G[row, state.at('current')], G[row, state.at(id_)] = plane_in_camera_jacobian(state, id_)
    return G


def _of_pair(state, pair, index, ids, settings, width):
    """Information matrix, vector and lasting columns of the correspondences at a state."""
    R, t = relative_motion(state)
    planes = np.array([plane_in_camera(state, id_) for id_ in ids]).reshape(-1, 3)
    A, b, _ = formulas.normal_equations(
        pair, R, t, planes, index, settings.relief, width=width, bias=settings.depth_bias,
        dependence=(settings.dependence, settings.depth_dependence))
    G, focal = observation_jacobian(state, ids), pair.focal.mean()
    leaning = settings.mover_bias * np.array([1.0, 1.0, pair.roll_arm])
    turn = np.hypot(settings.vector_bias, leaning) / focal
    A, b = without_turn(A, b, turn)
    lasting = np.zeros((state.size, N_LASTING))
    lasting[:, TURN] = G.T @ A[:, :3] * turn
    longer = np.r_[rotation.log(R), t, -planes.ravel()].reshape(-1, 3)
    lasting[:, FOCAL] = G.T @ (A @ stretched(longer).ravel()) * settings.focal_sigma
    angles = np.array([[0.0, -1.0], [1.0, 0.0], [0.0, 0.0]])
    displaced = np.vstack([R - np.eye(3), *map(rotation.skew, (t, *planes))]) @ angles
    lasting[:, PLACE] = G.T @ (A @ displaced) * settings.place_bias / focal
    return G.T @ A @ G, G.T @ b, lasting


def update(state, start, pair, index, ids, settings, observations):
    """Error, covariance and lasting errors after the iterated update, Joseph's form."""
    e = start
    for step in range(settings.iterations):
        moved = state.moved(e)
        M, v, lasting = _of_pair(moved, pair, index, ids, settings, 3.0 if step else 6.0)
        for one in observations:
            innovation, H = linearised(one, moved)
            M, v = M + H.T @ H / one.sigma**2, v + H.T @ innovation / one.sigma**2
            lasting = lasting + H.T @ np.tile(one.lasting, (len(H), 1)) / one.sigma**2
        gain = np.linalg.solve((np.eye(state.size) + M @ state.P).T, state.P).T
        before, e = e, gain @ (v + M @ e)
        if np.max(np.abs(e - before)) < 1e-6:
            break
    L = np.eye(state.size) - gain @ M
    return (e, L @ state.P @ L.T + gain @ M @ gain.T,
            state.error.lasting + gain @ (lasting - M @ state.error.lasting))


def squared_distance(state, plane, settings):
    """Squared Mahalanobis distance of a plane seen from the state, in baselines."""
    in_camera = plane_in_camera(state, plane.id)
    by_pose, by_plane = plane_in_camera_jacobian(state, plane.id)
    _, t = relative_motion(state)
    length = np.linalg.norm(t)
    by_previous, by_current = relative_motion_jacobian(state)
    H = np.zeros((3, state.size))
    H[:, state.at(plane.id)] = by_plane * length
    direction = np.outer(in_camera, t / length)
    H[:, state.at('previous')] = direction @ by_previous[3:]
    H[:, state.at('current')] = by_pose * length + direction @ by_current[3:]
    biased = settings.depth_bias * plane.plane
    S = H @ state.P @ H.T + plane.covariance * settings.depth_dependence + np.outer(biased, biased)
    innovation = plane.plane - in_camera * length
    return innovation @ np.linalg.solve(S, innovation)


def counts(x_cur, label, plane_id):
    """Which blocks (N,) the scene filter takes, and which are ties of their surroundings."""
    still = (label == 0) | (label == 2)
    cell = np.floor((x_cur.astype(float) + 0.5) / 16).astype(int)
    cell = tuple((cell - cell.min(axis=0)).T)
    total, agree, taken = np.zeros((3, *(np.max(cell, axis=1) + 1)))
    np.add.at(total, cell, 1.0)
    np.add.at(agree, cell, still.astype(float))
    np.add.at(taken, cell, label == 1)
    around, agreeing = (25 * ndimage.uniform_filter(grid, 5, mode='constant')[cell]
                        for grid in (total, agree))
    beside = ndimage.binary_dilation(taken > 0, np.ones((3, 3)))[cell]
    share = agreeing / around
    return still & ((plane_id >= 0) | ~(beside | (share < 0.5 - 1e-9)))


def dependence(pair, R, t, width):
    """Variance of a mean of errors over what independent ones would have."""
    error = formulas.epipolar_error(pair.rays_cur, pair.rays_prev, pair.focal, R, t) / pair.sigma
    bounded = 1 / (1 + np.square(error / width))
    weight = np.square(bounded)
    slope = weight - 4 * np.square(error / width) * bounded**3
    cell = np.floor(pair.x_prev / 16).astype(int)
    cell -= cell.min(axis=0)
    total = np.zeros(cell.max(axis=0) + 1)
    np.add.at(total, tuple(cell.T), weight * error)
    around = ndimage.uniform_filter(total, 5, mode='constant') * 25
    variance = np.sum(total * around) / len(error)
    return variance * weight.mean() / max(slope.mean(), 0.1)**2


def depth_slope(pair, R, t, max_spread, relief):
    """Derivative (6,) of the mean log of inverse depth by (w, t)."""
    rho, J = formulas.inverse_depth_jacobian(pair.rays_cur, pair.rays_prev, pair.focal, R, t)
    _, per_pixel = two_view.inverse_depth(pair.rays_cur, pair.rays_prev, pair.focal, R, t)
    sigma = per_pixel * pair.sigma
    sure = sigma < max_spread * rho
    weight = 1 / (np.square(sigma[sure] / rho[sure]) + relief**2)
    return weight @ (J[sure] / rho[sure, None]) / weight.sum()


def plane_in_world(state, id_):
    """Normal, depth and covariance (4, 4) of a plane in {W}."""
    anchored = state.planes[id_]
    normal, depth = formulas.to_normal_depth(anchored.plane)
    J = formulas.normal_depth_jacobian(anchored.plane)
    J[3] -= anchored.anchor @ J[:3]
    return normal, depth - normal @ anchored.anchor, J @ scene_gauge.covariance(state, id_) @ J.T
