"""The two motions that one plane allows: the epipolar lines fit both alike, the depths only one.

Where a plane fills the picture, as under a camera that looks down on a floor, the essential matrix
is that of either motion. The wrong one puts a part of the plane behind the camera.
"""

import cv2
from mv_slapse.geometry import two_view
from mv_slapse.motion.estimate import MotionFit, refined_from
import numpy as np

# Sum of robust costs by which another motion must explain a pair better than the last one. Where
# one plane fills the picture two motions do almost alike (0.3 % of 1300 blocks, as measured), and
# six neighbouring blocks tell as much as one: e^5 to one.
AMBIGUITY = 30.0
# Share behind the camera beyond which the other motion is tried. Wrong vectors and movers made up
# to 0.17 in 2000 pairs of streets and flights; the wrong motion over a floor makes 0.2 to 0.45.
MANY_BEHIND = 0.2
# Mean robust cost by which a twin may explain the epipolar lines worse: over a floor the right one
# did by up to 0.034, a motion that was none of the plane's by 0.36.
ALIKE = 0.1


def likeliest(pair: two_view.Pair, predicted: MotionFit | None,
              others: list[MotionFit]) -> MotionFit:
    """Return the motion that explains a pair best; the predicted one when in doubt.

    A block behind the camera is one that the motion does not explain.
    """
    fits = [fit for fit in (predicted, *others) if fit is not None]
    costs = [_cost(fit) for fit in fits]
    if predicted is not None and (costs[0] - min(costs)) * len(pair) < AMBIGUITY:
        return fits[0]
    return fits[int(np.argmin(costs))]


def unfolded(pair: two_view.Pair, fit: MotionFit) -> MotionFit:
    """Return a motion, or its twin if that has more of the blocks in front."""
    if fit.behind < MANY_BEHIND:
        return fit
    others = [refined_from(pair, R, t) for R, t in from_homography(pair)]
    twins = [other for other in others if other.cost - fit.cost < ALIKE]
    return min([fit, *twins], key=_cost)


def from_homography(pair: two_view.Pair) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the motions (R (3, 3), unit t (3,)) of the plane that most blocks lie on.

    Empty where no homography was found, or one without parallax.
    """
    H, _ = cv2.findHomography(
        pair.rays_prev[:, :2].copy(), pair.rays_cur[:, :2].copy(), cv2.USAC_MAGSAC,
        1.0 / pair.focal[0])
    if H is None:
        return []
    _, rotations, ways, _ = cv2.decomposeHomographyMat(H, np.eye(3))
    return [(R, t[:, 0] / np.linalg.norm(t)) for R, t in zip(rotations, ways, strict=True)
            if np.linalg.norm(t) > 1e-6]


def _cost(fit: MotionFit) -> float:
    return fit.cost + fit.behind
