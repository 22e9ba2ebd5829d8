"""What ground one vehicle may stand on: cars side by side are wider than any.

Cars in neighbouring lanes go at one speed and at one distance, so that their motion may not tell
them apart; the ground that they cover does. Nor does it tell of cars in one picture that are far
behind each other; but the road shows below the farther one.
"""

from collections.abc import Sequence

from mv_slapse.changed import replace
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.rotation import norm
from mv_slapse.kernels.binding import compiled
from mv_slapse.obstacles import motion_model as om
from mv_slapse.obstacles.detection import about, box_of, Detection, MOST
from mv_slapse.obstacles.view import View
from mv_slapse.records import Extraction, Label
import numpy as np

WIDTH, LENGTH = 2.55, 18.75  # [m] of the largest vehicles on roads, directive 96/53/EC
SURE = 2.0  # standard deviations by which all may be in favour of one vehicle
HOLLOW = 1.25 * MACROBLOCK  # px by which a lower edge is hollow beyond its rounding to a block,
COLUMNS = 2  # and as many of blocks on either side: as the smallest region has
BELOW = 2 * MACROBLOCK  # px below a surface where most blocks show the road if it is a foot


def may_be_one(whole: Detection, view: View) -> bool:
    """Return whether surfaces taken together are no wider than one vehicle across its way.

    Its sides point the way it goes. A ray through the left end of the foot and one through the
    right end meet it somewhere between its nearest and its farthest corner; of these places those
    count that make it narrowest. True where no ground tells the distance.
    """
    if view.ground is None or not whole.has_depth:
        return True
    aside, unsure = _aside(whole, view)
    ends = np.sort(_ends(whole.box, view) @ aside)
    inner, outer = sorted(np.abs(ends))
    near = np.exp(whole.z[2] - SURE * np.sqrt(whole.R[2, 2]))
    length = LENGTH * view.metre
    width = outer * near + (inner * near if ends[0] * ends[1] < 0 else -inner * (near + length))
    return bool(width < WIDTH * view.metre + SURE * unsure * length)


def bodies(whole: Detection, view: View, least: int) -> list[Detection]:
    """Return a surface that is too wide for one vehicle as two, where its lower edge is hollow.

    The ground that a vehicle covers is a rectangle, whose near sides bulge towards the camera.
    Either has ``least`` blocks, and the smaller one the complement of the id. Else itself.
    """
    if may_be_one(whole, view):
        return [whole]
    left = whole.x[:, 0] < compiled.hollow(whole.x, whole.block, MACROBLOCK, HOLLOW, COLUMNS)
    sides = sorted((~left, left), key=np.count_nonzero, reverse=True)
    if np.count_nonzero(sides[1]) < least:
        return [whole]
    parts = [about(whole, whole.x[side], whole.block[side], view) for side in sides]
    if any(part.edge is whole.edge for part in parts):
        return [whole]  # one does not show where it stands
    return [parts[0], replace(parts[1], id=min(~whole.id, whole.id))]


def stand_apart(surfaces: Sequence[Detection], extraction: Extraction, view: View) -> bool:
    """Return whether surfaces stand on places that no vehicle covers together.

    A surface stands where its lower edge is if that is the lowest of all, or if the labels of the
    extraction show the scene below it; else it may be any part of what stands there. The first one
    tells which way they go.
    """
    if view.ground is None or not surfaces[0].has_depth:
        return False
    lowest = max(item.edge.row for item in surfaces if item.has_depth)
    feet = [item for item in surfaces if item.has_depth
            and (item.edge.row == lowest or _scene_below(item, lowest, extraction))]
    if len(feet) < 2:
        return False
    aside, unsure = _aside(surfaces[0], view)
    depth = np.exp([item.z[2] for item in feet])
    ends = depth[:, None] * np.sort([_foot(item, view) @ aside for item in feet], axis=1)
    left, right = np.argmin(ends[:, 0]), np.argmax(ends[:, 1])
    # The worst case: what their depths err by all in favour of one vehicle.
    sigma = sum(abs(ends[i, side]) * np.sqrt(feet[i].R[2, 2])
                for i, side in ((left, 0), (right, 1)))
    width = ends[right, 1] - ends[left, 0]
    slack = sigma + unsure * abs(depth[right] - depth[left])
    return bool(width > WIDTH * view.metre + SURE * slack)


def _scene_below(surface, lowest, extraction):
    """Whether the scene shows right below a surface, down to the ``lowest`` row."""
    row, box = surface.edge.row, surface.box
    x, y = extraction.x_cur.T
    below = ((x > box[0]) & (x < box[0] + box[2]) & (y > row) & (y < min(row + BELOW, lowest)))
    still = extraction.label[below] == Label.STATIONARY.value
    return np.count_nonzero(still) > MOST * len(still)


def _aside(surface, view):
    """Return what points across its way on the ground, (3,), and how unsure that is [rad]."""
    motion = om.motion(surface.z, surface.R, view.scene_velocity, view.scene_covariance)
    (a, b, c), (x, y, z) = view.ground.tolist(), motion.velocity.tolist()
    aside = np.array([b * z - c * y, c * x - a * z, a * y - b * x])
    speed = norm(aside) / norm(view.ground)
    aside /= max(norm(aside), 1e-12)
    return aside, np.sqrt(aside @ motion.covariance[3:, 3:] @ aside) / max(speed, 1e-12)


def _foot(surface, view):
    """Return the rays (2, 3) of the ends of its lowest row, the rest of which may be farther."""
    x, block = surface.x, surface.block
    lowest = x[:, 1] + block[:, 1] / 2 > surface.edge.row - MACROBLOCK / 2
    return _ends(box_of(x[lowest], block[lowest]), view)


def _ends(box, view):
    """Return the rays (2, 3) of the lower corners of a box, which is known to half a block."""
    x, y, width, height = box
    return to_rays(view.K, np.array([[x + MACROBLOCK / 2, y + height],
                                     [x + width - MACROBLOCK / 2, y + height]]))
