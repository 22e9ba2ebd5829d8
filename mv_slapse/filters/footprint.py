"""What ground one vehicle may stand on: cars side by side are wider than any.

Cars in neighbouring lanes go at one speed and at one distance, so that their motion may not tell
them apart; the ground that they cover does.
"""

from mv_slapse.filters import obstacle_motion as om
from mv_slapse.filters.detections import Detection
from mv_slapse.filters.view import View
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.geometry.camera import to_rays
import numpy as np

WIDTH, LENGTH = 2.55, 18.75  # [m] of the largest vehicles on roads, directive 96/53/EC
SURE = 2.0  # standard deviations by which all may be in favour of one vehicle


def may_be_one(whole: Detection, view: View) -> bool:
    """Return whether surfaces taken together are no wider than one vehicle across its way.

    Its sides point the way it goes. A ray through the left end of the foot and one through the
    right end meet it somewhere between its nearest and its farthest corner; of these places those
    count that make it narrowest. True where no ground tells the distance.
    """
    if view.ground is None or not whole.has_depth:
        return True
    motion = om.motion(whole.z, whole.R, view.scene_velocity, view.scene_covariance)
    aside = np.cross(view.ground, motion.velocity)
    speed = np.linalg.norm(aside) / np.linalg.norm(view.ground)
    aside /= max(np.linalg.norm(aside), 1e-12)
    unsure = np.sqrt(aside @ motion.covariance[3:, 3:] @ aside) / max(speed, 1e-12)
    box = whole.box
    foot = box[1] + box[3]
    # The outline is known to half a block at either end.
    ends = np.sort(to_rays(view.K, np.array([[box[0] + MACROBLOCK / 2, foot],
                                             [box[0] + box[2] - MACROBLOCK / 2, foot]])) @ aside)
    inner, outer = sorted(np.abs(ends))
    near = np.exp(whole.z[2] - SURE * np.sqrt(whole.R[2, 2]))
    length = LENGTH * view.metre
    width = outer * near + (inner * near if ends[0] * ends[1] < 0 else -inner * (near + length))
    return bool(width < WIDTH * view.metre + SURE * unsure * length)
