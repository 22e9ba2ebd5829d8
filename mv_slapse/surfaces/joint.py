"""Joint re-estimation of camera motion and stationary planes, (10) of [MVO]."""

from mv_slapse.geometry import rotation, two_view
import numpy as np


def reestimate(pair: two_view.Pair, R, t, planes, index, relief: float, steps: int = 4,
               expected=()):
    """Minimise (10) over rotation, direction and planes.

    Gauss-Newton with Levenberg-Marquardt damping; |t| stays 1, the unit of the pair.

    Parameters
    ----------
    pair : Pair
        Stationary correspondences.
    R, t : (3, 3), (3,) arrays
        Start, X_cur = R X_prev + t with |t| = 1.
    planes : (P, 3) array
        Start, n / d in camera k [1/baseline].
    index : (N,) int array
        Plane of each correspondence, -1 for none.
    relief : float
        See two_view.plane_terms.
    steps : int
    expected : sequence of (int, (3,) array, (3, 3) array), optional
        What is known of a plane beforehand: its number, mean and information.

    Returns
    -------
    R, t, planes : arrays
    covariance : (6 + 3 P, 6 + 3 P) array
        Of (rotation, direction, planes); singular along t.
    """
    planes = np.array(planes, float).reshape(-1, 3)
    damping = 1e-6
    A, b, cost, lift = _tangent_equations(pair, R, t, planes, index, relief, expected)
    for _ in range(steps):
        step = lift @ np.linalg.solve(A + damping * np.diag(np.diag(A) + 1e-12), b)
        trial = _moved(R, t, planes, step)
        new = _tangent_equations(pair, *trial, index, relief, expected)
        if new[2] > cost:
            damping = max(damping * 100, 1e-3)
            continue
        converged = cost - new[2] < 1e-4 * cost
        (R, t, planes), (A, b, cost, lift) = trial, new
        damping *= 0.1
        if converged:
            break
    return R, t, planes, lift @ np.linalg.pinv(A, hermitian=True) @ lift.T


def _moved(R, t, planes, step):
    """Apply a step of (w, t, planes) and bring t back to unit length."""
    t_new = t + step[3:6]
    return (rotation.exp(step[:3]) @ R, t_new / np.linalg.norm(t_new),
            planes + step[6:].reshape(-1, 3))


def _tangent_equations(pair, R, t, planes, index, relief, expected):
    """Return A, b by (w, two tangents of t, planes), the cost, and the lift back to t."""
    A, b, cost = two_view.normal_equations(pair, R, t, planes, index, relief, width=3.0)
    for i, mean, information in expected:
        at = slice(6 + 3 * i, 9 + 3 * i)
        off = mean - planes[i]
        A[at, at] += information
        b[at] += information @ off
        cost += float(off @ information @ off)
    lift = np.zeros((len(b), len(b) - 1))
    lift[:3, :3], lift[3:6, 3:5] = np.eye(3), rotation.tangent_basis(t)
    lift[6:, 5:] = np.eye(len(b) - 6)
    return lift.T @ A @ lift, lift.T @ b, cost, lift
