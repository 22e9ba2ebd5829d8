"""Joint re-estimation of camera motion and stationary planes, (10) of [MVO]."""

from mv_slapse.geometry import two_view
from mv_slapse.kernels.binding import compiled
import numpy as np

LEFT_OUT = -2  # in place of a plane's number: what moves by itself


def reestimate(pair: two_view.Pair, start, index, relief: float, *, steps: int = 4, expected=()):
    """Minimise (10) over rotation, direction and planes.

    Gauss-Newton with Levenberg-Marquardt damping; |t| stays 1, the unit of the pair.

    Parameters
    ----------
    start : R (3, 3), t (3,), planes (P, 3)
        X_cur = R X_prev + t with |t| = 1; n / d in camera k [1/baseline].
    index : (N,) int array
        Plane of each correspondence; -1 tells of the motion alone; LEFT_OUT of nothing.
    relief : float
        Standard deviation of a surface's depth about its plane, as a share of depth.
    expected : sequence of (int, (3,) array, (3, 3) array)
        What is known of a plane beforehand: its number, mean and information.

    Returns
    -------
    R, t, planes : arrays
    covariance : (6 + 3 P, 6 + 3 P) array
        Of (rotation, direction, planes); singular along t.
    """
    options = np.array([relief, two_view.KERNEL_WIDTH, 1.0, 1.0, 0.0, 0.0])
    R, t, planes = start
    return compiled.reestimate(
        *two_view.columns(pair, R, t), np.ascontiguousarray(index, np.int64),
        np.array(planes, float).reshape(-1, 3), options, list(expected), steps)
