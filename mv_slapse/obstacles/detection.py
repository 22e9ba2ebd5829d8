"""Moving planes of one key frame pair as observations of the obstacle filters, (16) of [MVO]."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

from mv_slapse.config import ObstacleSettings
from mv_slapse.geometry import epipolar, moving_plane
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.geometry.camera import to_rays
from mv_slapse.obstacles import motion_model as om
from mv_slapse.obstacles.view import View
from mv_slapse.records import Extraction, Label, PlaneHandover, ScalePrior
import numpy as np
from scipy.ndimage import label as components

OUTLINE_SHARE = 0.08  # of a region's size: how well its blocks show its middle
CUT_SHARE = 0.3  # the same where the picture's edge cuts it off
TURN_SHARE = 0.015  # of its motion by a turn of the camera: 0.010 to 0.021 in six rendered spins
SHAPE_SHARE = 0.03  # of a rate: vehicles are no planes, and their faces move apart
THINNEST = 0.25  # share of the most blocks in a row or column: a cabin has more of a body
SLIVER = 2.0  # px by which neighbouring blocks may overlap, as predicted
HIDDEN_CONTACT_SIGMA = 0.3  # of ln Z where the picture's edge cuts the region off below


class Edge(NamedTuple):
    """Lower edge of a region, known to a block, from which its depth comes.

    Attributes
    ----------
    row : float
        [px].
    half : float
        The true edge lies within this many rows of it [px].
    drop : float
        Rows below the horizon, f times the camera's height over the depth [px].
    """

    row: float
    half: float
    drop: float

    def log_depth(self, value: float, rows: float) -> float:
        """Return what ln Z is if the edge lies ``rows`` lower, ``value`` if it lies here."""
        return value - float(np.log(max(1 + rows / self.drop, 0.1)))


@dataclass(frozen=True)
class Detection:
    """A moving plane of one key frame pair.

    Attributes
    ----------
    id : int
        Of the plane observation.
    z, R : (8,), (8, 8) float64
        Observed state as in obstacle_motion, and its covariance.
    has_depth : bool
        The depth is evidence; else a prior that only a new track may use.
    has_rate : bool
        The rate is evidence; else only the place is, and an obstacle with no other coasts.
    x, block : (N, 2) float64
        Centres and sizes of its blocks [px].
    scale_prior : ScalePrior
    edge : Edge
        Where it meets the ground; only read where the depth is evidence.
    score, departed : float, float
        How much rather its region moves than not, and has left where it stood, as of
        PlaneObservation.
    """

    id: int
    z: np.ndarray
    R: np.ndarray
    has_depth: bool
    x: np.ndarray
    block: np.ndarray
    scale_prior: ScalePrior
    edge: Edge
    score: float = 0.0
    departed: float = 0.0
    has_rate: bool = True

    @property
    def box(self) -> np.ndarray:
        """Return x, y of the top left corner, width, height [px]."""
        return box_of(self.x, self.block)


def box_of(x: np.ndarray, block: np.ndarray) -> np.ndarray:
    """Return the box (4,) around blocks: top left corner, width, height [px]."""
    low, high = np.min(x - block / 2, axis=0), np.max(x + block / 2, axis=0)
    return np.r_[low, high - low]


def inside(x: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Return which pixels (N, 2) lie in a box (4,), (N,) bool."""
    return np.all((x >= box[:2]) & (x <= box[:2] + box[2:]), axis=1)


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
    edge = np.minimum(0.5 * SLIVER, 0.25 * (high - low))
    first, last = low + edge, high - edge
    at = np.unique(np.r_[first, last])
    cover = thickness @ ((first[:, None] <= at[:-1]) & (last[:, None] > at[:-1]))
    thick = np.flatnonzero(cover >= THINNEST * np.max(cover))
    return (max(at[thick[0]] - 0.5 * SLIVER, np.min(low)),
            min(at[thick[-1] + 1] + 0.5 * SLIVER, np.max(high)))


def tiles(box: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return blocks (N, 2), (N, 2) that fill a box (4,), about as large as macroblocks [px]."""
    number = np.maximum(np.round(box[2:] / MACROBLOCK), 1).astype(int)
    size = box[2:] / number
    place = np.indices(number).reshape(2, -1).T
    return box[:2] + (place + 0.5) * size, np.tile(size, (len(place), 1))


def is_cut(box: np.ndarray, view: View) -> np.ndarray:
    """Return whether the picture's edge cuts a box (4,) off across and down, (2,) bool."""
    return np.any(cut_sides(box, view), axis=0)


def cut_sides(box: np.ndarray, view: View) -> np.ndarray:
    """Return the same for its first and last side, (2, 2) bool."""
    return np.array([box[:2] < MACROBLOCK / 2, box[:2] + box[2:] > view.size - MACROBLOCK / 2])


def detections(extraction: Extraction, view: View, settings: ObstacleSettings) -> list[Detection]:
    """Return the moving planes of an extraction, largest first."""
    found = []
    for plane in extraction.planes:
        if plane.label is not Label.MOVING:
            continue
        x, block = _blocks(extraction, plane.id)
        if len(x) < settings.min_macroblocks or plane.covariance.shape != (6, 6):
            continue
        scale = np.repeat([1 / view.unit, view.unit], 3)
        found.append(_detection(plane.id, scale * np.r_[plane.plane, plane.t_d],
                                plane.covariance * np.outer(scale, scale), x, block,
                                plane.scale_prior, view, plane.score, plane.departed))
    found = [_on_ground(blurred(item, view, settings), view) for item in found
             if item is not None]
    return sorted(found, key=lambda item: (-len(item.x), item.id))


def from_handover(handover: PlaneHandover, extraction: Extraction, view: View,
                  settings: ObstacleSettings) -> Detection | None:
    """Return a plane handed over by the scene filter as the first detection of a track.

    Its blocks are those that the extraction counts to the plane, whatever their label; None
    where there are too few.
    """
    x, block = _blocks(extraction, handover.id)
    if len(x) < settings.min_macroblocks:
        return None
    plane, by_plane = view.plane_to_cam(handover.plane)
    by_state = np.zeros((6, 6))
    by_state[:3, :3] = by_plane
    by_state[3:, 3:] = -view.dt * view.R_world_from_cam.T
    t_d = by_state[3:, 3:] @ handover.velocity
    return _detection(handover.id, np.r_[plane, t_d],
                      by_state @ handover.covariance @ by_state.T, x, block,
                      ScalePrior.GROUND_CONTACT, view)


def joined(group: Sequence[Detection], view: View) -> Detection:
    """Return the detection of a vehicle: the motion of its first surface, the blocks of all."""
    first = group[0]
    if len(group) == 1:
        return first
    x = np.concatenate([item.x for item in group])
    block = np.concatenate([item.block for item in group])
    box = box_of(x, block)
    whole = replace(_moved(first, _centre(box, view)), x=x, block=block)
    whole.R[om.BEARING, om.BEARING] = bearing_covariance(box, block, view)
    return _on_ground(whole, view)


def _moved(detection, centre):
    """Return a detection's state about another ray (2,) of its plane."""
    offset = centre - detection.z[om.BEARING]
    rate, slope = detection.z[om.RATE], detection.z[om.SLOPE]
    # A plane that is seen edge-on tells nothing of what lies beside it.
    w = np.clip(1 + slope @ offset, 0.5, 2.0)
    J = np.eye(om.SIZE)
    J[2, om.SLOPE] = -offset / w
    J[om.RATE, om.RATE] = w * np.eye(3)
    J[om.RATE, om.SLOPE] = np.outer(rate, offset)
    J[om.SLOPE, om.SLOPE] = np.eye(2) / w - np.outer(slope, offset) / w**2
    z = np.r_[centre, detection.z[2] - np.log(w), w * rate, slope / w]
    return replace(detection, z=z, R=J @ detection.R @ J.T)


def _blocks(extraction, plane_id):
    """Return centres and sizes of the largest connected part of a plane's blocks."""
    at = extraction.plane_id == plane_id
    x, block = extraction.x_cur[at].astype(float), extraction.block[at].astype(float)
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


def _detection(id_, state, covariance, x, block, prior, view, score=0.0, departed=0.0):
    """Return the Detection of (plane, t_d) in the camera [map unit], None if behind it."""
    box = box_of(x, block)
    centre = _centre(box, view)
    if -state[:3] @ np.r_[centre, 1.0] <= 1e-9 or not np.all(np.isfinite(covariance)):
        return None
    theta, jacobian = moving_plane.from_plane(state[:3], state[3:], centre, view.t_cur_from_prev)
    if np.any(np.abs(theta[moving_plane.SLOPE]) > om.SLOPE_LIMIT):
        return None
    covariance = jacobian @ covariance @ jacobian.T
    order = [5, 0, 1, 2, 3, 4]
    scale = np.r_[1.0, np.full(3, 1 / view.dt), 1.0, 1.0]
    R = np.zeros((om.SIZE, om.SIZE))
    R[2:, 2:] = covariance[np.ix_(order, order)] * np.outer(scale, scale)
    R[om.BEARING, om.BEARING] = bearing_covariance(box, block, view)
    contact = moving_plane.contact(x, block)
    return Detection(id_, np.r_[centre, theta[order] * scale], R,
                     prior is ScalePrior.GROUND_CONTACT, x, block, prior,
                     _edge(contact, R[2, 2]), score, departed)


def _centre(box, view):
    """Return the ray (2,) of a box's middle."""
    return to_rays(view.K, (box[:2] + box[2:] / 2)[None])[0, :2]


def bearing_covariance(box, block, view):
    """Return how well a box shows the ray (2,) of the middle of what it surrounds, (2, 2)."""
    share = np.where(is_cut(box, view), CUT_SHARE, OUTLINE_SHARE)
    return np.diag((np.max(block, axis=0)**2 / 12 + (share * box[2:])**2)
                   / np.diag(view.K)[:2]**2)


def _edge(contact, variance):
    """Return the Edge of a contact that gives ln Z with a variance."""
    return Edge(float(contact.point[1]), np.sqrt(3) * contact.sigma,
                contact.sigma / max(float(np.sqrt(variance)), 1e-6))


def blurred(detection, view, settings):
    """Return a detection with what all its vectors have in common in the rate's covariance.

    A bias of the encoder, which weighs more on the growth of a small region and grows with the
    camera's turn, the error of that, and the error of the plane.
    """
    x, y = detection.z[om.BEARING]
    focal, ray = np.diag(view.K)[:2], np.array([[x, y, 1.0]])
    turned = TURN_SHARE * (epipolar.derotate(ray, view.R_cur_from_prev.T) - ray)[0, :2]
    error = np.hypot(settings.vector_bias, np.linalg.norm(focal * turned))
    growth = error / max(0.5 * float(np.min(detection.box[2:])), MACROBLOCK / 2)
    turn = np.array([[-x * y, 1 + x * x, -y], [-1 - y * y, x * y, x], [0.0, 0.0, 0.0]])
    shared = turn @ view.rotation_covariance @ turn.T
    shared += np.diag(np.r_[(settings.vector_bias / focal)**2, growth**2])
    shared[:2, :2] += np.outer(turned, turned)
    R = detection.R.copy()
    rate = detection.z[om.RATE]
    R[om.RATE, om.RATE] += shared / view.dt**2 + SHAPE_SHARE**2 * (rate @ rate) * np.eye(3)
    return replace(detection, R=R)


def _on_ground(detection, view):
    """Take the depth from the map's ground plane, which is steadier than the pair's own."""
    if view.ground is None:
        return detection
    contact = moving_plane.contact(detection.x, detection.block)
    depth = moving_plane.contact_depth(view.ground, contact, view.K, detection.z[om.SLOPE],
                                       detection.z[om.BEARING])
    if depth is None:
        return detection
    hidden = contact.point[1] + MACROBLOCK > view.size[1]
    swap = np.eye(om.SIZE)
    swap[2, 2] = 0.0
    swap[2, om.SLOPE] = depth.by_slope
    R = swap @ detection.R @ swap.T
    R[2, 2] += depth.variance + (HIDDEN_CONTACT_SIGMA**2 if hidden else 0.0)
    z = detection.z.copy()
    z[2] = depth.value
    return replace(detection, z=z, R=R, has_depth=True, scale_prior=ScalePrior.GROUND_CONTACT,
                   edge=_edge(contact, depth.variance))
