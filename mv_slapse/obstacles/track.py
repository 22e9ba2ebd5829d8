"""One moving obstacle over time: its filter, its outline and the evidence for it."""

from dataclasses import dataclass, field
import math
from typing import NamedTuple

from mv_slapse.changed import replace
from mv_slapse.config import ObstacleSettings
from mv_slapse.filters import ekf
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.geometry.rotation import norm
from mv_slapse.kernels.binding import compiled
from mv_slapse.obstacles import association
from mv_slapse.obstacles import motion_model as om
from mv_slapse.obstacles.detection import body_box, box_of, Detection, Edge, is_cut
from mv_slapse.obstacles.lifecycle import Evidence, within
from mv_slapse.obstacles.view import UNSCALED_SPEED, View
from mv_slapse.records import Extraction, Label, Obstacle, ObstacleState, PlaneHandover, ScalePrior
import numpy as np

KEPT_EVIDENCE = 2.0  # [s]
DRIFT_GAIN = 0.3
UNREST_RANGE = (0.3, 3.0)  # of the acceleration, calm and in a manoeuvre
POINT_SHARE, PART_SHARE = 0.1, 0.5  # of an obstacle's size; the latter at the picture's edge
OUTLINE_TIMES = 2.0  # correlation times over which outlines are averaged, which err alike in one
NO_PLANE = -1  # id of the plane of a track whose plane is another one's now


class EdgeRules(NamedTuple):
    """Constants of what the lower edge tells of the depth."""

    share: float = 0.3  # [1/sqrt(s)] of its uncertainty that comes anew with time
    foot_sigma: float = 2.5  # [px] by which it is wrong for as long as the obstacle looks the same
    crossing_sigma: float = 3.0  # [px] where it is seen to cross from one row to the next
    clearance: float = 0.12  # of ln Z: vehicles from behind end 0.2 m above the road, of 1.65 m


EDGE = EdgeRules()


@dataclass
class Track:
    """A moving obstacle."""

    id: int  # lasts as long as the track
    plane_id: int  # of the plane seen that continued it last; NO_PLANE: that is another one's now
    mu: np.ndarray  # (8,): state of motion_model
    P: np.ndarray  # (8, 8): its covariance
    x: np.ndarray  # (N, 2): block centres, moved on by the prediction [px]
    block: np.ndarray  # (N, 2): their sizes [px]
    extent: np.ndarray  # (4,): box of its body, averaged over detections and moved on, too [px]
    edge: Edge  # lower edge of the last detection that showed one
    scale_prior: ScalePrior
    first_seen: int  # [ns]
    last_seen: int  # [ns]
    confirmed: bool = False
    # (3,): running mean of the rate's innovation in standard deviations: near 0 unless it speeds
    # up, brakes or turns
    drift: np.ndarray = field(default_factory=lambda: np.zeros(3))
    evidence: list[Evidence] = field(default_factory=list)

    def predict(self, step: om.CameraStep, view: View, settings: ObstacleSettings) -> bool:
        """Move on to the newest key frame, (15); False where the obstacle is out of sight."""
        still = step.t_cur_from_prev / step.dt
        speed = norm(still) + math.exp(self.mu[2]) * norm(self.mu[om.RATE])
        unit = 1.0 if view.is_metric else UNSCALED_SPEED * speed
        moved = om.predict(self.mu, step, still, view.scene_covariance,
                           settings.acceleration * unit * self._unrest())
        if moved is None:
            return False
        mu, F, Q = moved
        old, new = (view.focal * ray[:2] + view.K[:2, 2] for ray in (self.mu, mu))
        growth = math.exp(min(max(self.mu[2] - mu[2], -1), 1))
        self.x = new + growth * (self.x - old)
        self.block = growth * self.block
        self.extent = growth * self.extent
        self.extent[:2] += new - growth * old
        # The block that hides the lower edge moves on with time, and its error with it: ln Z is
        # never known better than a share of it.
        Q[2, 2] += (EDGE.share * self.edge.half / self.edge.drop)**2 * step.dt
        self.mu, self.P = mu, F @ self.P @ F.T + Q
        return bool(np.minimum(self.box(view), self.body(view))[2:].min() > 0)

    def update(self, detection: Detection, extraction: Extraction, view: View,
               settings: ObstacleSettings):
        """Correct the state by a detection, (16), and keep what it says of the motion.

        A place alone is no evidence: the less is known of the way the more blocks pass there.
        """
        shared = association.box_overlap(self.box(view), clipped(detection.box, view))
        distance, dof = association.squared_distance(self.mu, self.P, detection)
        excess = max(1.0, distance / ekf.chi2_bound(settings.gate, dof))
        if excess > 1 and detection.has_rate and self._disagreed(settings):
            # Twice is no accident: it is the state that is wrong, not the detection.
            self.P = excess * self.P
            excess = 1.0
        rate = (detection.z - self.mu)[om.RATE]
        sigma = np.sqrt((self.P + detection.R).diagonal()[om.RATE])
        self.drift = self.drift + detection.has_rate * DRIFT_GAIN * (rate / sigma - self.drift)
        evidence = self._depth_evidence(
            replace(detection, R=_correlated(detection.R, view.dt, settings)), view.dt)
        self.mu, self.P = compiled.correct_elements(
            self.mu, self.P, evidence.z, excess * evidence.R,
            association.observed(evidence.has_depth, evidence.has_rate))
        self.mu[om.SLOPE] = np.minimum(
            np.maximum(self.mu[om.SLOPE], -om.SLOPE_LIMIT), om.SLOPE_LIMIT)
        self.plane_id, self.x, self.block = detection.id, detection.x, detection.block
        if detection.has_depth:
            self.scale_prior, self.edge = detection.scale_prior, detection.edge
        if detection.has_rate:
            self._follow(extraction.stamp, view, settings)
            self.witness(extraction, view, detection, distance, dof, shared)

    def begin_again(self, detection: Detection, extraction: Extraction, view: View):
        """Forget all but the id and the age: what was seen before is another body, or none."""
        vars(self).update(vars(start(detection, extraction, view, self.id))
                          | {'first_seen': self.first_seen})

    def scale(self, unit: float):
        """Go on in a unit of length that makes ``unit`` of the one so far."""
        self.mu[om.LOG_DEPTH] += np.log(unit)
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
            names += ['mu', 'P', 'extent', 'edge', 'scale_prior', 'drift', 'evidence']
        else:
            self.evidence = within([*self.evidence, other.evidence[-1]], KEPT_EVIDENCE)
        for name in names:
            setattr(self, name, getattr(other, name))

    def _follow(self, stamp, view, settings):
        """Draw the extent towards that of the newest blocks.

        Where the picture's edge cuts it off it changes faster than the prediction can tell.
        """
        seen, count = body_box(self.x, self.block), len(self.evidence) + 1
        lasts = max(OUTLINE_TIMES * settings.correlation_time, 1e-6)
        share = max(1 - math.exp(-1e-9 * (stamp - self.last_seen) / lasts), 1 / count)
        gain = np.where(is_cut(seen, view), 1.0, share)
        self.extent = self.extent + np.concatenate((gain, gain)) * (seen - self.extent)

    def _disagreed(self, settings):
        """Return whether the last evidence lay outside the gate."""
        last = self.evidence[-1]
        return last.dof > 0 and last.nis > ekf.chi2_bound(settings.gate, last.dof)

    def _unrest(self):
        """Return the factor on the acceleration: a constant velocity needs little of it."""
        expected = len(self.drift) * DRIFT_GAIN / (2 - DRIFT_GAIN)
        return min(max(self.drift @ self.drift / expected, UNREST_RANGE[0]), UNREST_RANGE[1])

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
            rows = min(max(0.5 * (jump + moved), -edge.half), edge.half)
            z[2] = edge.log_depth(z[2], rows)
        else:
            z[2] = min(max(self.mu[2], edge.log_depth(z[2], edge.half)),
                       edge.log_depth(z[2], -edge.half))
        if not detection.has_depth or z[2] == self.mu[2]:
            return detection
        R[2, :], R[:, 2] = 0.0, 0.0
        R[2, 2] = (EDGE.crossing_sigma**2 + moved**2 / 12) / edge.drop**2
        return replace(detection, z=z, R=R)

    def witness(self, extraction: Extraction, view: View, detection: Detection,
                nis: float = 0.0, dof: int = 0, overlap: float = 1.0):
        """Keep what the newest detection says, for plane management.

        ``nis``, ``dof`` and ``overlap`` tell how well it fits the track that it corrects, as of
        Evidence; a new one's fits by itself.
        """
        self.last_seen = extraction.stamp
        # A bumper ends above the road, so that what stands looks as if it came towards the camera.
        nearer = EDGE.clearance if self.scale_prior is ScalePrior.GROUND_CONTACT else 0.0
        statistic = om.moving_statistic(self.mu, self.P, view.scene_velocity,
                                        view.scene_covariance, nearer)
        speed = norm(self.motion(view).velocity)
        self.evidence.append(Evidence(extraction.previous_stamp, extraction.stamp, statistic,
                                      nis, dof, speed, overlap, detection.score,
                                      detection.called))
        self.evidence = within(self.evidence, KEPT_EVIDENCE)

    def height(self, view: View) -> float:
        """Return how tall it looks [map unit], less a macroblock and a half for the outline."""
        seen = self.box(view)[3] - 1.5 * MACROBLOCK
        return math.exp(self.mu[2]) * float(seen / view.K[1, 1])

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

        [s], [s^2]; infinite where the depth does not shrink: -1 / rate[2].
        """
        closing = -self.mu[5]
        if closing <= 0:
            return np.inf, np.inf
        return float(1 / closing), float(self.P[5, 5] / closing**4)

    def obstacle(self, stamp: int, view: View) -> Obstacle:
        """Return the record of this track at a key frame."""
        seen, foot, box = self.last_seen == stamp, None, self.body(view)
        state = ObstacleState.TENTATIVE if not self.confirmed else (
            ObstacleState.CONFIRMED if seen else ObstacleState.COASTING)
        if self.scale_prior is ScalePrior.GROUND_CONTACT and view.ground is not None:
            foot = (self.edge.row, EDGE.foot_sigma / self.edge.drop, view.ground,
                    view.ground_normal_covariance)
        # A vehicle shows some of its side as well, and the picture's edge may cut it off.
        share = PART_SHARE if is_cut(box, view).any() else POINT_SHARE
        *motion, surface = compiled.obstacle_in_world(
            self.mu, self.P, self.extent, (view.K, view.R_world_from_cam, view.t_world_from_cam,
                                           view.scene_velocity, view.scene_covariance),
            share * float((box[2:] / view.focal).max()), foot)
        return Obstacle(self.id, stamp, state, *motion, *self.time_to_contact(), box, surface,
                        len(self.x), 1e-9 * (stamp - self.first_seen), self.last_seen,
                        self.scale_prior)

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


def start(detection: Detection, extraction: Extraction, view: View, track_id: int) -> Track:
    """Return a new track of a detection."""
    track = Track(track_id, detection.id, detection.z.copy(), detection.R.copy(), detection.x,
                  detection.block, body_box(detection.x, detection.block), detection.edge,
                  detection.scale_prior, extraction.stamp, extraction.stamp)
    track.witness(extraction, view, detection)
    return track


def clipped(box: np.ndarray, view: View) -> np.ndarray:
    """Return the part of a box (4,) that lies in the picture [px]; no size where none does."""
    (x, y, width, height), (across, down) = box.tolist(), view.size.tolist()
    left, top = min(max(x, 0.0), across), min(max(y, 0.0), down)
    return np.array([left, top, min(max(x + width, 0.0), across) - left,
                     min(max(y + height, 0.0), down) - top])


def _correlated(R, dt, settings):
    """Widen what is wrong alike in successive pairs, so that repeating it does not sharpen it.

    A region's outline sits on the same lattice of blocks for a while: as many pairs as fit into
    twice the correlation time tell as much as one.
    """
    factor = math.sqrt(max(1.0, 2 * settings.correlation_time / dt))
    scale = np.full(om.SIZE, factor)
    scale[om.RATE] = 1.0
    return R * np.outer(scale, scale)
