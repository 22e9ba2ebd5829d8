"""Formulas of obstacles in numpy, for the comparison with their kernels."""

from formulas import derotate
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.geometry.camera import to_rays
from mv_slapse.obstacles import detection as rules
from mv_slapse.obstacles import redetection
from mv_slapse.obstacles.motion_model import (
    BEARING,
    MANOEUVRE_TIME,
    RATE,
    SIZE,
    SLOPE,
    SLOPE_LIMIT,
    SLOPE_NOISE,
)
import numpy as np
from scipy.ndimage import label as components

from benchmarks.papers import moving_plane


def predict(mu, step, after, after_covariance, acceleration):
    """Move a state to the next key frame at constant velocity in {W}, (15) of [MVO].

    Parameters
    ----------
    mu : (8,) array
    step : CameraStep
    after, after_covariance : (3,), (3, 3) arrays
        Velocity of the scene relative to the camera over this step, in current axes.
    acceleration : float
        Of the obstacle, standard deviation [unit/s^2].

    Returns
    -------
    mu, F, Q : (8,), (8, 8), (8, 8) arrays or None
        None where the obstacle passes behind the camera.
    """
    R, dt = step.R_cur_from_prev, step.dt
    cartesian, to = to_cartesian(mu)
    velocity = R @ (cartesian[3:6] - step.before)
    moved = np.r_[R @ cartesian[:3] + step.t_cur_from_prev + dt * velocity, velocity + after,
                  R @ cartesian[6:]]
    if moved[2] <= 0.05 * np.exp(mu[2]) or moved[6:] @ moved[:3] <= 0.05 * moved[2]:
        return None
    linear = np.kron(np.eye(3), R)
    linear[:3, 3:6] = dt * R
    back, from_ = from_cartesian(moved)
    noise = np.zeros((9, 9))
    noise[:6, :6] = _motion_noise(dt, acceleration, R @ step.before_covariance @ R.T,
                                  after_covariance)
    Q = from_ @ noise @ from_.T
    Q[SLOPE, SLOPE] += SLOPE_NOISE**2 * dt * np.eye(2)
    return back, from_ @ linear @ to, Q


def _motion_noise(dt, acceleration, before, after):
    """Covariance (6, 6) of position and relative velocity: acceleration and the camera's speed."""
    spectral_density = 2 * MANOEUVRE_TIME * acceleration**2
    pushed = spectral_density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    known = np.array([[dt**2, dt], [dt, 1.0]])
    return (np.kron(pushed, np.eye(3)) + np.kron(known, before)
            + np.kron(np.diag([0.0, 1.0]), after))


def to_cartesian(mu: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return position, relative velocity and w, (9,), and their derivative (9, 8)."""
    (x, y), depth, (A, B) = mu[BEARING], np.exp(mu[2]), mu[SLOPE]
    ray, w = np.array([x, y, 1.0]), np.array([A, B, 1 - A * x - B * y])
    jacobian = np.zeros((9, SIZE))
    jacobian[:3, BEARING] = depth * np.eye(3, 2)
    jacobian[:3, 2] = depth * ray
    jacobian[3:6, 2] = depth * mu[RATE]
    jacobian[3:6, RATE] = depth * np.eye(3)
    jacobian[8, BEARING] = -A, -B
    jacobian[6:, SLOPE] = np.vstack([np.eye(2), [-x, -y]])
    return np.r_[depth * ray, depth * mu[RATE], w], jacobian


def from_cartesian(cartesian: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the state (8,) of position, relative velocity and w at any scale, derivative (8, 9).

    The inverse of ``to_cartesian``; the position must lie in front of the camera.
    """
    X, V, w = cartesian[:3], cartesian[3:6], cartesian[6:]
    depth = X[2]
    ray, facing = X / depth, w @ X / X[2]
    slope = w[:2] / facing
    by_bearing = np.c_[np.eye(2), -ray[:2]] / depth
    jacobian = np.zeros((SIZE, 9))
    jacobian[BEARING, :3] = by_bearing
    jacobian[2, 2] = 1 / depth
    jacobian[RATE, 2] = -V / depth**2
    jacobian[RATE, 3:6] = np.eye(3) / depth
    jacobian[SLOPE, :3] = -np.outer(slope / facing, w[:2] @ by_bearing)
    jacobian[SLOPE, 6:] = (np.eye(2, 3) - np.outer(slope, ray)) / facing
    return np.r_[ray[:2], np.log(depth), V / depth, slope], jacobian


def motion(mu, P, scene, scene_covariance):
    """Return position, velocity in the world and their covariance, in camera axes."""
    cartesian, jacobian = to_cartesian(mu)
    covariance = jacobian[:6] @ P @ jacobian[:6].T
    covariance[3:, 3:] += scene_covariance
    return (cartesian[:3], cartesian[3:6] - scene, covariance)


def obstacle_in_world(mu, P, extent, view, point, foot):
    """Return plane, position, velocity, covariance and corners of an obstacle in {W}."""
    K, R, t, scene, scene_covariance = view
    position, velocity, covariance = motion(mu, P, scene, scene_covariance)
    depth, rate = np.exp(mu[2]), mu[RATE]
    covariance[:3, :3] += (point * depth)**2 * np.eye(3)
    covariance[3:, 3:] += (point * depth)**2 * np.outer(rate, rate)
    if foot is not None:
        row, sigma, ground, ground_covariance = foot
        ray = np.r_[mu[0], (row - K[1, 2]) / K[1, 1], 1.0]
        normal = ground / np.linalg.norm(ground)
        tilt = ray @ ground_covariance @ ray / max((normal @ ray)**2, 1e-6)
        along = depth * np.r_[mu[BEARING], 1.0, rate]
        covariance += (sigma**2 + tilt) * np.outer(along, along)
    turn = np.kron(np.eye(2), R)
    plane = R @ (-to_cartesian(mu)[0][6:] / depth)
    plane = plane / (1 - plane @ t)
    corners = to_rays(K, extent[:2] + extent[2:] * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]))
    nearer = np.clip(1 + (corners[:, :2] - mu[:2]) @ mu[SLOPE], 0.5, 2.0)
    return (plane, R @ position + t, R @ velocity, turn @ covariance @ turn.T,
            (corners * (depth / nearer)[:, None]) @ R.T + t)


def moving_statistic(mu, P, scene, scene_covariance, nearer=0.0):
    """Return the smallest squared distance of "it stands still" over all depths."""
    speed = max(np.linalg.norm(scene), 1e-12)
    ahead = scene / speed
    along = ahead @ scene_covariance @ ahead
    variance = P[2, 2] + along / speed**2
    sigma = np.where(np.arange(81) < 40, np.sqrt(variance + nearer**2), np.sqrt(variance))
    offset = np.linspace(-4, 4, 81) * sigma
    gain = P[RATE, 2] / variance
    conditional = P[RATE, RATE] - np.outer(gain, P[RATE, 2])
    inverse_depth = np.exp(-(mu[2] + offset))[:, None]
    error = mu[RATE] + offset[:, None] * gain - inverse_depth * scene
    aside = scene_covariance - along * np.outer(ahead, ahead)
    S = conditional + inverse_depth[:, :, None]**2 * aside
    distance = np.einsum('ni,ni->n', error, np.linalg.solve(S, error[:, :, None])[:, :, 0])
    return float(np.min(distance + (offset / sigma)**2))


def correct(mu, P, z, R, rows):
    """Return mean and covariance after an observation of some elements, Joseph form."""
    H = np.eye(len(mu))[rows]
    S = H @ P @ H.T + R[np.ix_(rows, rows)]
    K = np.linalg.solve(S, H @ P).T
    I_KH = np.eye(len(mu)) - K @ H
    P = I_KH @ P @ I_KH.T + K @ R[np.ix_(rows, rows)] @ K.T
    return mu + K @ (z - mu)[rows], 0.5 * (P + P.T)


def box_of(x: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return the box (4,) around blocks: top left corner, width, height [px]."""
    low, high = np.min(x - block / 2, axis=0), np.max(x + block / 2, axis=0)
    return np.r_[low, high - low]


def body_box(x: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return the box (4,) between the first and last rows and columns that many blocks cover.

    What is behind or beside a vehicle joins it with single blocks, which move every edge of the
    box around them all.
    """
    low, high = x - block / 2, x + block / 2
    first, last = np.transpose([_well_covered(low[:, axis], high[:, axis], block[:, 1 - axis])
                                for axis in (0, 1)])
    return np.r_[first, last - first]


def _well_covered(low, high, thickness):
    """Return the first and last place [px] that intervals cover thickly enough."""
    # Blocks that were moved may overlap by little, and would cover that little twice.
    edge = np.minimum(0.5 * rules.SLIVER, 0.25 * (high - low))
    first, last = low + edge, high - edge
    at = np.unique(np.r_[first, last])
    cover = thickness @ ((first[:, None] <= at[:-1]) & (last[:, None] > at[:-1]))
    thick = np.flatnonzero(cover >= rules.THINNEST * np.max(cover))
    return (max(at[thick[0]] - 0.5 * rules.SLIVER, np.min(low)),
            min(at[thick[-1] + 1] + 0.5 * rules.SLIVER, np.max(high)))


def hollow(x, block, least, columns):
    """Return where the lower edge lies highest above the lines between all its places, or NaN."""
    left = (x[:, 0] - block[:, 0] / 2).min()
    n = round(((x[:, 0] + block[:, 0] / 2).max() - left) / MACROBLOCK)
    edge = np.full(n, -np.inf)
    for (x_, y), (width, height) in zip(x, block, strict=True):
        for k in range(n):  # those of which a block covers a quarter or more
            begin = left + k * MACROBLOCK
            common = min(x_ + width / 2, begin + MACROBLOCK) - max(x_ - width / 2, begin)
            if common > MACROBLOCK / 4:
                edge[k] = max(edge[k], y + height / 2)
    lower = np.array([np.median([edge[max(k - 1, 0)], edge[k], edge[min(k + 1, n - 1)]])
                      for k in range(n)])
    gap = [max((lower[i] + (lower[k] - lower[i]) * (j - i) / (k - i)
                for i in range(j) for k in range(j + 1, n)), default=-np.inf) - lower[j]
           for j in range(columns, n - columns)]
    deep = np.flatnonzero(np.array(gap) > max([least, *(np.array(gap) - 1e-9)]))
    return left + MACROBLOCK * (columns + (deep[0] + deep[-1]) / 2 + 0.5) if len(deep) else np.nan


def largest_part(x, block, plane_id, number):
    """Return centres and sizes of the largest connected part of a plane's blocks."""
    at = plane_id == number
    x, block = x[at].astype(float), block[at].astype(float)
    if len(x) < 2:
        return x, block
    cell = np.floor(x / MACROBLOCK).astype(int)
    cell -= cell.min(axis=0)
    lattice = np.zeros(cell.max(axis=0) + 1, bool)
    lattice[tuple(cell.T)] = True
    # A block missing inside a surface must not tear it apart: fill single gaps before joining.
    padded = np.pad(lattice, 1)
    grown = padded[:-2, 1:-1] | padded[2:, 1:-1] | padded[1:-1, :-2] | padded[1:-1, 2:] | lattice
    part = components(grown, np.ones((3, 3)))[0][tuple(cell.T)]
    largest = part == np.argmax(np.bincount(part))
    return x[largest], block[largest]


def shared_cells(x, other):
    """Return the share of the smaller set's cells that both hold."""
    a, b = ({tuple(cell) for cell in np.floor(points / MACROBLOCK).astype(int).tolist()}
            for points in (x, other))
    return len(a & b) / max(min(len(a), len(b)), 1)


def bearing_covariance(box, block, K, size):
    """Return how well a box shows the ray of the middle of what it surrounds, (2, 2)."""
    cut = (box[:2] < MACROBLOCK / 2) | (box[:2] + box[2:] > size - MACROBLOCK / 2)
    share = np.where(cut, rules.CUT_SHARE, rules.OUTLINE_SHARE)
    return np.diag((np.max(block, axis=0)**2 / 12 + (share * box[2:])**2) / np.diag(K)[:2]**2)


def from_plane(plane: np.ndarray, t_d: np.ndarray, centre: np.ndarray,
               t_cur_from_prev: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return theta (6,) of a plane and its displacement and the derivative (6, 6).

    The inverse of ``to_plane``; the centre's ray must meet the plane in front of the camera.
    """
    ray = np.r_[centre, 1.0]
    inverse_depth = -plane @ ray
    slope = -plane[:2] / inverse_depth
    relative = t_cur_from_prev - t_d
    jacobian = np.zeros((6, 6))
    jacobian[moving_plane.RATE, :3] = -np.outer(relative, ray)
    jacobian[moving_plane.RATE, 3:] = -inverse_depth * np.eye(3)
    jacobian[moving_plane.SLOPE, :3] = (-np.eye(2, 3) + np.outer(slope, ray)) / inverse_depth
    jacobian[moving_plane.LOG_DEPTH, :3] = ray / inverse_depth
    return np.r_[inverse_depth * relative, slope, -np.log(inverse_depth)], jacobian


def region_state(state, covariance, x, block, view):
    """Return z, R and the lower edge of a moving plane's blocks, or None."""
    box = box_of(x, block)
    centre = to_rays(view.K, (box[:2] + box[2:] / 2)[None])[0, :2]
    if -state[:3] @ np.r_[centre, 1.0] <= 1e-9 or not np.all(np.isfinite(covariance)):
        return None
    theta, jacobian = from_plane(state[:3], state[3:], centre, view.t_cur_from_prev)
    if np.any(np.abs(theta[moving_plane.SLOPE]) > SLOPE_LIMIT):
        return None
    order = [5, 0, 1, 2, 3, 4]
    scale = np.r_[1.0, np.full(3, 1 / view.dt), 1.0, 1.0]
    R = np.zeros((SIZE, SIZE))
    R[2:, 2:] = (jacobian @ covariance @ jacobian.T)[np.ix_(order, order)] * np.outer(scale, scale)
    R[BEARING, BEARING] = bearing_covariance(box, block, view.K, view.size)
    return np.r_[centre, theta[order] * scale], R, _edge(moving_plane.contact(x, block), R[2, 2])


def _edge(contact, variance):
    return np.array([contact.point[1], np.sqrt(3) * contact.sigma,
                     contact.sigma / max(np.sqrt(variance), 1e-6)])


def state_about(z, R, centre):
    """Return a plane's state and covariance about another ray (2,) of it."""
    offset = centre - z[BEARING]
    rate, slope = z[RATE], z[SLOPE]
    w = np.clip(1 + slope @ offset, 0.5, 2.0)
    J = np.eye(SIZE)
    J[2, SLOPE] = -offset / w
    J[RATE, RATE] = w * np.eye(3)
    J[RATE, SLOPE] = np.outer(rate, offset)
    J[SLOPE, SLOPE] = np.eye(2) / w - np.outer(slope, offset) / w**2
    return np.r_[centre, z[2] - np.log(w), w * rate, slope / w], J @ R @ J.T


def blurred(z, R, box, bias, view):
    """Return a covariance with what all vectors have in common."""
    x, y = z[BEARING]
    focal, ray = np.diag(view.K)[:2], np.array([[x, y, 1.0]])
    turned = rules.TURN_SHARE * (derotate(ray, view.R_cur_from_prev.T) - ray)[0, :2]
    error = np.hypot(bias, np.linalg.norm(focal * turned))
    growth = error / max(0.5 * np.min(box[2:]), MACROBLOCK / 2)
    turn = np.array([[-x * y, 1 + x * x, -y], [-1 - y * y, x * y, x], [0.0, 0.0, 0.0]])
    shared = turn @ view.rotation_covariance @ turn.T
    shared += np.diag(np.r_[(bias / focal)**2, growth**2])
    shared[:2, :2] += np.outer(turned, turned)
    out, rate = R.copy(), z[RATE]
    out[RATE, RATE] += shared / view.dt**2 + rules.SHAPE_SHARE**2 * (rate @ rate) * np.eye(3)
    return out


def on_ground(z, R, x, block, view):
    """Return z, R and edge with the depth of the ground under the lower edge, or None."""
    contact = moving_plane.contact(x, block)
    depth = moving_plane.contact_depth(view.ground, contact, view.K, z[SLOPE], z[BEARING])
    if depth is None:
        return None
    swap = np.eye(SIZE)
    swap[2, 2] = 0.0
    swap[2, SLOPE] = depth.by_slope
    R, z = swap @ R @ swap.T, z.copy()
    hidden = contact.point[1] + MACROBLOCK > view.size[1]
    R[2, 2] += depth.variance + (rules.CUT_SHARE**2 if hidden else 0.0)
    z[2] = depth.value
    return z, R, _edge(contact, depth.variance)


def transfer(theta: np.ndarray, rays: np.ndarray, centre: np.ndarray, K: np.ndarray,
             R_cur_from_prev: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where a moving plane's points were in the previous key frame, (11) of [MVO].

    Parameters
    ----------
    theta : (5,), (6,) or (N, 5) array
        Rate and slope, of one plane or for each ray.
    rays : (N, 3) array
        Of key frame k.
    centre : (2,) or (N, 2) array
        First two coordinates of the centre's ray.
    K, R_cur_from_prev : (3, 3) arrays

    Returns
    -------
    x_prev : (N, 2) array
        [px].
    jacobian : (N, 2, 5) array
        By rate and slope.
    """
    g, offset, KR = theta[..., moving_plane.RATE], rays[:, :2] - centre, K @ R_cur_from_prev.T
    w = 1 + np.sum(offset * theta[..., moving_plane.SLOPE], axis=1)
    x = (rays - w[:, None] * g) @ KR.T
    by_theta = np.empty((len(rays), 3, 5))
    by_theta[:, :, moving_plane.RATE] = -w[:, None, None] * KR
    by_theta[:, :, moving_plane.SLOPE] = -(g @ KR.T)[..., :, None] * offset[:, None, :]
    x_prev = x[:, :2] / x[:, 2:]
    lost = by_theta[:, :2] - x_prev[:, :, None] * by_theta[:, 2:]
    return x_prev, lost / x[:, 2, None, None]


def redetected_rate(mu, P, rays, target, variance, view, limit):
    """Return displacement over depth, its covariance, and which blocks move so (N,), twice."""
    prior = view.dt**2 * P[RATE, RATE]
    theta = np.r_[view.dt * mu[RATE], mu[SLOPE]]
    weak = redetection.WEAK * np.linalg.inv(prior)  # one block alone leaves the rate open
    error, J = _errors(theta, mu, rays, target, view)
    S = J @ prior @ np.swapaxes(J, 1, 2) + variance[:, None, None] * np.eye(2)
    near = np.einsum('ni,ni->n', error, np.linalg.solve(S, error[:, :, None])[:, :, 0]) < limit
    for i in range(redetection.ITERATIONS if near.any() else 0):
        squared = np.sum(error**2, axis=1) / variance
        # While the start is bad the kernel is twice as wide as half of the blocks reach.
        width = max(limit, 4 * np.median(squared[near])) if i < redetection.COARSE else limit
        weighted = J * (near / (1 + squared / width)**2 / variance)[:, None, None]
        information = np.einsum('nij,nik->jk', weighted, J) + weak
        theta[moving_plane.RATE] += np.linalg.solve(
            information, np.einsum('nij,ni->j', weighted, error))
        error, J = _errors(theta, mu, rays, target, view)
    squared = np.sum(error**2, axis=1) / variance
    own = near & (squared < limit)
    information = np.einsum('nij,nik->jk', J[own] / variance[own, None, None], J[own]) + weak
    spread = squared[own].sum() / max(2 * own.sum() - 3, 1)
    return theta[moving_plane.RATE], max(spread, 1.0) * np.linalg.inv(information), near, own


def _errors(theta, mu, rays, target, view):
    """Return errors (N, 2) of a rate and slope (5,) [px] and their Jacobian (N, 2, 3) by rate."""
    x_prev, J = transfer(theta, rays, mu[BEARING], view.K, view.R_cur_from_prev)
    return target - x_prev, J[:, :, moving_plane.RATE]
