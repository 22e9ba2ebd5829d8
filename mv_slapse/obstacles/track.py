"""One moving obstacle over time: its filter, its outline and the evidence for it."""

from dataclasses import dataclass, field, replace

from mv_slapse.config import ObstacleSettings
from mv_slapse.filters import ekf
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.geometry.camera import to_rays
from mv_slapse.obstacles import association
from mv_slapse.obstacles import motion_model as om
from mv_slapse.obstacles.detection import body_box, box_of, cut_sides, Detection, Edge, is_cut
from mv_slapse.obstacles.lifecycle import Evidence, within
from mv_slapse.obstacles.view import View
from mv_slapse.records import Extraction, Label, Obstacle, ObstacleState, PlaneHandover, ScalePrior
import numpy as np

UNSCALED_ACCELERATION = 0.1  # [1/s] of the speed, per unit of the setting
KEPT_EVIDENCE = 2.0  # [s]
DRIFT_GAIN = 0.3
UNREST_RANGE = (0.3, 3.0)  # of the acceleration, calm and in a manoeuvre
EDGE_SHARE = 0.3  # [1/sqrt(s)]
POINT_SHARE, PART_SHARE = 0.1, 0.5  # of an obstacle's size; the latter at the picture's edge
FOOT_SIGMA = 2.5  # [px] by which it is wrong for as long as the obstacle looks the same
SAME_OUTLINE = 0.6  # overlap with the predicted box of 96 % of right detections, or more
LEAST_SHARED = 0.1  # of it, that counts
SETTLED = 3  # detections that tell where the outline should be
OUTLINE_TIMES = 2.0  # correlation times over which outlines are averaged, which err alike in one
BODY = ('state', 'extent', 'edge', 'scale_prior', 'drift')  # what a track knows of a vehicle
NO_PLANE = -1  # id of the plane of a track whose plane is another one's now
CLEARANCE = 0.12  # of ln Z: vehicles seen from behind end 0.2 m above the road, of 1.65 m
BOUNDARY_SIGMA = 3.0  # [px] of a lower edge that is seen to cross from one row to the next


@dataclass
class Track:
    """A moving obstacle.

    Attributes
    ----------
    id : int
        Lasts as long as the track.
    plane_id : int
        Of the plane observation that continued it last; NO_PLANE: it continues another one now.
    state : ekf.State
        Blocks 'bearing', 'log_depth', 'rate', 'slope' of obstacle_motion.
    x, block : (N, 2) float64
        Block centres, moved on by the prediction, and sizes [px].
    extent : (4,) float64
        Box of its body, averaged over its detections and moved on, too [px].
    edge : Edge
        Lower edge of the last detection that showed one.
    scale_prior : ScalePrior
    first_seen, last_seen : int, int
        Stamps [ns].
    confirmed : bool
    drift : (3,) float64
        Running mean of the rate's innovation in standard deviations: near 0 unless it speeds up,
        brakes or turns.
    evidence : list of Evidence
    """

    id: int
    plane_id: int
    state: ekf.State
    x: np.ndarray
    block: np.ndarray
    extent: np.ndarray
    edge: Edge
    scale_prior: ScalePrior
    first_seen: int
    last_seen: int
    confirmed: bool = False
    drift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    evidence: list[Evidence] = field(default_factory=list)

    @property
    def mu(self) -> np.ndarray:
        """Return the mean (8,) of the state."""
        return self.state.mu

    @property
    def P(self) -> np.ndarray:
        """Return the covariance (8, 8) of the state."""
        return self.state.P

    def predict(self, step: om.CameraStep, view: View, settings: ObstacleSettings) -> bool:
        """Move on to the newest key frame, (15); False where the obstacle is out of sight."""
        still = step.t_cur_from_prev / step.dt
        speed = np.linalg.norm(still) + np.exp(self.mu[2]) * np.linalg.norm(self.mu[om.RATE])
        unit = 1.0 if view.is_metric else UNSCALED_ACCELERATION * speed
        moved = om.predict(self.mu, step, still, view.scene_covariance,
                           settings.acceleration * unit * self._unrest())
        if moved is None:
            return False
        mu, F, Q = moved
        focal, centre = np.diag(view.K)[:2], view.K[:2, 2]
        old, new = focal * self.mu[:2] + centre, focal * mu[:2] + centre
        growth = np.exp(np.clip(self.mu[2] - mu[2], -1, 1))
        self.x = new + growth * (self.x - old)
        self.block = growth * self.block
        self.extent = growth * self.extent
        self.extent[:2] += new - growth * old
        # The block that hides the lower edge moves on with time, and its error with it: ln Z is
        # never known better than a share of it.
        Q[2, 2] += (EDGE_SHARE * self.edge.half / self.edge.drop)**2 * step.dt
        ekf.predict(self.state, mu, F, Q)
        return bool(np.all(np.minimum(self.box(view), self.body(view))[2:] > 0))

    def update(self, detection: Detection, extraction: Extraction, view: View,
               settings: ObstacleSettings):
        """Correct the state by a detection, (16), and keep what it says of the motion.

        A place alone is no evidence: the less is known of the way the more blocks pass there.
        """
        box = self.box(view)
        shared = association.box_overlap(box, clipped(detection.box, view))
        if shared < SAME_OUTLINE and len(self.evidence) >= SETTLED:
            detection = _doubted(detection, shared, box, view)
        distance, dof = association.squared_distance(self.mu, self.P, detection)
        excess = max(1.0, distance / ekf.chi2_bound(settings.gate, dof))
        if excess > 1 and detection.has_rate and self._disagreed(settings):
            # Twice is no accident: it is the state that is wrong, not the detection.
            self.state.P *= excess
            excess = 1.0
        rate = (detection.z - self.mu)[om.RATE]
        sigma = np.sqrt(np.diag(self.P + detection.R)[om.RATE])
        self.drift = self.drift + detection.has_rate * DRIFT_GAIN * (rate / sigma - self.drift)
        evidence = self._depth_evidence(
            replace(detection, R=_correlated(detection.R, view.dt, settings)), view.dt)
        rows = association.observed(evidence)
        ekf.update(self.state, evidence.z[rows] - self.mu[rows], np.eye(om.SIZE)[rows],
                   evidence.R[np.ix_(rows, rows)] * excess)
        self.state.mu[om.SLOPE] = np.clip(self.mu[om.SLOPE], -om.SLOPE_LIMIT, om.SLOPE_LIMIT)
        self.plane_id, self.x, self.block = detection.id, detection.x, detection.block
        if detection.has_depth:
            self.scale_prior, self.edge = detection.scale_prior, detection.edge
        if detection.has_rate:
            self._follow(extraction.stamp, view, settings)
            self.witness(extraction, view, distance, dof, shared, detection.score,
                         detection.departed)

    def scale(self, unit: float):
        """Go on in a unit of length that makes ``unit`` of the one so far."""
        self.state.mu[om.LOG_DEPTH] += np.log(unit)
        self.evidence = [e._replace(speed=unit * e.speed) for e in self.evidence]

    def contains(self, part: 'Detection | Track', view: View, gate: float) -> bool:
        """Return whether a detection, or another track, is a part of this obstacle."""
        state = (part.z, part.R) if isinstance(part, Detection) else (part.mu, part.P)
        box = part.box if isinstance(part, Detection) else part.box(view)
        return association.is_part((self.mu, self.P), self.box(view), state, box, gate)

    def continue_as(self, other: 'Track'):
        """Go on where another track of the same obstacle saw it last.

        State and extent are those of the two whose depth is better known: the other may be new
        and have seen a part only, the foot of which is hidden.
        """
        names = ['x', 'block', 'last_seen']
        names += ['plane_id'] * (other.plane_id != NO_PLANE)
        if other.P[2, 2] < self.P[2, 2]:
            names += [*BODY, 'evidence']
        else:
            self.evidence = within([*self.evidence, other.evidence[-1]], KEPT_EVIDENCE)
        self._take(other, names)

    def may_show(self, detection: Detection, view: View, gate: float) -> bool:
        """Return whether a detection at the edge of the picture may be a face of this obstacle.

        The same edge cuts both, and they have one velocity.
        """
        if not np.any(cut_sides(self.extent, view) & cut_sides(detection.box, view)):
            return False
        old, new = self.motion(view), om.motion(detection.z, detection.R, view.scene_velocity,
                                                np.zeros((3, 3)))
        return ekf.squared_distance(new.velocity - old.velocity, (
            new.covariance + old.covariance)[3:, 3:]) < ekf.chi2_bound(gate, 3)

    def restart(self, detection: Detection, extraction: Extraction, view: View):
        """Go on with what a detection alone tells, as of another face of the same vehicle."""
        new = start(detection, extraction, view, self.id)
        self._take(new, ('x', 'block', 'last_seen', 'plane_id', *BODY))
        self.evidence = within([*self.evidence, *new.evidence], KEPT_EVIDENCE)

    def _take(self, other, names):
        """Take what another track has under some names."""
        for name in names:
            setattr(self, name, getattr(other, name))

    def _follow(self, stamp, view, settings):
        """Draw the extent towards that of the newest blocks.

        Where the picture's edge cuts it off it changes faster than the prediction can tell.
        """
        seen, count = body_box(self.x, self.block), len(self.evidence) + 1
        lasts = max(OUTLINE_TIMES * settings.correlation_time, 1e-6)
        share = max(1 - np.exp(-1e-9 * (stamp - self.last_seen) / lasts), 1 / count)
        gain = np.where(is_cut(seen, view), 1.0, share)
        self.extent = self.extent + np.tile(gain, 2) * (seen - self.extent)

    def _disagreed(self, settings):
        """Return whether the last evidence lay outside the gate."""
        last = self.evidence[-1]
        return last.dof > 0 and last.nis > ekf.chi2_bound(settings.gate, last.dof)

    def _unrest(self):
        """Return the factor on the acceleration: a constant velocity needs little of it."""
        expected = len(self.drift) * DRIFT_GAIN / (2 - DRIFT_GAIN)
        return np.clip(np.sum(self.drift**2) / expected, *UNREST_RANGE)

    def _depth_evidence(self, detection, dt):
        """Return the detection with what its lower edge says of the depth beyond the last one.

        The edge is known to a block only, and stays on it while the obstacle keeps its distance.
        It speaks clearly where the prediction leaves the block, and where it jumps to the next
        row: then the true edge lay between the two at some time of the pair.
        """
        edge, z, R = detection.edge, detection.z.copy(), detection.R.copy()
        jump = self.edge.row - edge.row
        moved = edge.drop * -self.mu[5] * dt
        if 0 < abs(jump) <= 3 * edge.half:
            z[2] = edge.log_depth(z[2], np.clip(0.5 * (jump + moved), -edge.half, edge.half))
        else:
            z[2] = np.clip(self.mu[2], edge.log_depth(z[2], edge.half),
                           edge.log_depth(z[2], -edge.half))
        if not detection.has_depth or z[2] == self.mu[2]:
            return detection
        R[2, :], R[:, 2] = 0.0, 0.0
        R[2, 2] = (BOUNDARY_SIGMA**2 + moved**2 / 12) / edge.drop**2
        return replace(detection, z=z, R=R)

    def witness(self, extraction: Extraction, view: View, nis: float, dof: int,
                overlap: float = 1.0, score: float = 0.0, departed: float = 0.0):
        """Keep what the newest detection says, for plane management."""
        self.last_seen = extraction.stamp
        # A bumper ends above the road, so that what stands looks as if it came towards the camera.
        nearer = CLEARANCE if self.scale_prior is ScalePrior.GROUND_CONTACT else 0.0
        statistic = om.moving_statistic(self.mu, self.P, view.scene_velocity,
                                        view.compared_covariance, nearer)
        speed = float(np.linalg.norm(self.motion(view).velocity))
        self.evidence.append(Evidence(extraction.previous_stamp, extraction.stamp, statistic, nis,
                                      dof, speed, overlap, score, departed))
        self.evidence = within(self.evidence, KEPT_EVIDENCE)

    def height(self, view: View) -> float:
        """Return how tall it looks [map unit], less a macroblock and a half for the outline."""
        seen = self.box(view)[3] - 1.5 * MACROBLOCK
        return float(np.exp(self.mu[2]) * seen / view.K[1, 1])

    def is_moving(self, settings: ObstacleSettings) -> bool:
        """Return whether the last evidence shows motion, whatever the labels say."""
        return self.evidence[-1].statistic > ekf.chi2_bound(settings.moving_confidence, 3)

    def motion(self, view: View) -> om.Motion:
        """Return position and velocity in the world in camera axes."""
        return om.motion(self.mu, self.P, view.scene_velocity, view.scene_covariance)

    def box(self, view: View) -> np.ndarray:
        """Return the box (4,) clipped to the picture [px]; no size where it is outside."""
        return clipped(box_of(self.x, self.block), view)

    def body(self, view: View) -> np.ndarray:
        """Return the extent (4,) in the picture, which is the box that it publishes."""
        return clipped(self.extent, view)

    def time_to_contact(self) -> tuple[float, float]:
        """Return the time until the seen surface reaches the camera's plane, and its variance.

        [s], [s^2]; infinite where the depth does not shrink. The filtered observable of
        ``planes.moving.time_to_contact``, -1 / rate[2].
        """
        closing = -self.mu[5]
        if closing <= 0:
            return np.inf, np.inf
        return float(1 / closing), float(self.P[5, 5] / closing**4)

    def obstacle(self, stamp: int, view: View) -> Obstacle:
        """Return the record of this track at a key frame."""
        motion = self.motion(view)
        motion.covariance[:] += self._never_averaged(view)
        turn = np.kron(np.eye(2), view.R_world_from_cam)
        seen = self.last_seen == stamp
        state = ObstacleState.TENTATIVE if not self.confirmed else (
            ObstacleState.CONFIRMED if seen else ObstacleState.COASTING)
        return Obstacle(
            self.id, stamp, state, view.plane_to_world(om.plane(self.mu))[0],
            view.to_world(motion.position), view.R_world_from_cam @ motion.velocity,
            turn @ motion.covariance @ turn.T, *self.time_to_contact(), self.body(view),
            self._surface(view), len(self.x), 1e-9 * (stamp - self.first_seen), self.last_seen,
            self.scale_prior)

    def _never_averaged(self, view):
        """Return what (6, 6) is wrong of position and velocity all the time.

        The middle of what is seen is not that of the surface; what a block shows of a vehicle's
        foot is the same from pair to pair; and the ground is as wrong as the map says.
        """
        point, rate = self._point_sigma(view)**2, self.mu[om.RATE]
        result = np.zeros((6, 6))
        result[:3, :3] = point * np.eye(3)
        result[3:, 3:] = point * np.outer(rate, rate)
        if self.scale_prior is ScalePrior.GROUND_CONTACT and view.ground is not None:
            foot = np.r_[self.mu[0], (self.edge.row - view.K[1, 2]) / view.K[1, 1], 1.0]
            normal = view.ground / np.linalg.norm(view.ground)
            tilt = foot @ view.ground_normal_covariance @ foot / max((normal @ foot)**2, 1e-6)
            along = np.exp(self.mu[2]) * np.r_[self.mu[om.BEARING], 1.0, rate]
            result += ((FOOT_SIGMA / self.edge.drop)**2 + tilt) * np.outer(along, along)
        return result

    def _point_sigma(self, view):
        """Return how far the middle of what is seen is from the middle of the surface [unit].

        A vehicle shows some of its side as well, and the picture's edge may cut it off.
        """
        box = self.body(view)
        share = PART_SHARE if np.any(is_cut(box, view)) else POINT_SHARE
        return share * np.max(box[2:] / np.diag(view.K)[:2]) * np.exp(self.mu[2])

    def handover(self, stamp: int, view: View) -> PlaneHandover:
        """Return the hand-over of this plane to the scene filter."""
        _, jacobian = om.to_cartesian(self.mu)
        plane = om.plane(self.mu)
        by_state = np.zeros((6, om.SIZE))
        by_state[:3] = -jacobian[6:] / np.exp(self.mu[2])
        by_state[:3, 2] -= plane
        by_state[3:] = jacobian[3:6]
        plane_world, by_plane = view.plane_to_world(plane)
        turn = np.zeros((6, 6))
        turn[:3, :3], turn[3:, 3:] = by_plane, view.R_world_from_cam
        covariance = by_state @ self.P @ by_state.T
        covariance[3:, 3:] += view.scene_covariance
        return PlaneHandover(stamp, self.plane_id, Label.STATIONARY, plane_world, np.zeros(3),
                             turn @ covariance @ turn.T)

    def _surface(self, view):
        """Return the corners (4, 3) of the seen surface in {W}: its extent on its plane."""
        low, size = self.extent[:2], self.extent[2:]
        corners = to_rays(view.K, low + size * np.array([[0, 0], [1, 0], [1, 1], [0, 1]]))
        relative = np.clip(1 + (corners[:, :2] - self.mu[:2]) @ self.mu[om.SLOPE], 0.5, 2.0)
        return view.to_world(corners * (np.exp(self.mu[2]) / relative)[:, None])


def start(detection: Detection, extraction: Extraction, view: View, track_id: int) -> Track:
    """Return a new track of a detection."""
    state = ekf.State()
    for name, at in (('bearing', om.BEARING), ('log_depth', om.LOG_DEPTH), ('rate', om.RATE),
                     ('slope', om.SLOPE)):
        state.add(name, detection.z[at], detection.R[at, at])
    state.P[:] = detection.R
    track = Track(track_id, detection.id, state, detection.x, detection.block,
                  body_box(detection.x, detection.block), detection.edge,
                  detection.scale_prior, extraction.stamp, extraction.stamp)
    track.witness(extraction, view, 0.0, 0, score=detection.score, departed=detection.departed)
    return track


def clipped(box: np.ndarray, view: View) -> np.ndarray:
    """Return the part of a box (4,) that lies in the picture [px]; no size where none does."""
    low = np.clip(box[:2], 0, view.size)
    return np.r_[low, np.clip(box[:2] + box[2:], 0, view.size) - low]


def _doubted(detection, shared, box, view):
    """Return a detection whose outline jumped, believed the less the less it shares of the box.

    Where two vehicles meet in the picture their blocks make one region for a while: its middle
    and its motion are of neither.
    """
    jump = (1 - shared) * np.maximum(detection.box[2:], box[2:]) / 2
    R = detection.R.copy()
    R[om.BEARING, om.BEARING] += np.diag((jump / np.diag(view.K)[:2])**2)
    R[om.RATE, om.RATE] /= max(shared, LEAST_SHARED)**2
    return replace(detection, R=R)


def _correlated(R, dt, settings):
    """Widen what is wrong alike in successive pairs, so that repeating it does not sharpen it.

    A region's outline sits on the same lattice of blocks for a while: as many pairs as fit into
    twice the correlation time tell as much as one.
    """
    factor = max(1.0, 2 * settings.correlation_time / dt)
    scale = np.ones(om.SIZE)
    scale[:3] = np.sqrt(factor)
    scale[om.SLOPE] = np.sqrt(factor)
    return R * np.outer(scale, scale)
