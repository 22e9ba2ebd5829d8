"""Records that cross a folder's border.

Stamps are integer nanoseconds everywhere. Pixels are centred at integers. Columns that travel in
messages are float32 here as well, so that a replay and a robot compute the same numbers.
``{W}`` (world) is the camera of the first key frame: x right, y down, z forward.
"""

from dataclasses import dataclass, field, replace
from enum import IntEnum

from mv_slapse.strip_matches import StripMatches
import numpy as np


class FrameType(IntEnum):
    """Picture type of a coded frame."""

    I = 1  # noqa: E741
    P = 2
    B = 3


class SegmentKind(IntEnum):
    """How a pair of key frames is joined, section V-A of [SLAPSE]."""

    IP = 0
    PP = 1
    PI = 2
    CHAINED = 3
    BROKEN = 4


class Label(IntEnum):
    """What a macroblock belongs to, Definition 1 and (7) of [MVO]; values of ``labels.npz``."""

    UNKNOWN = -1
    STATIONARY = 0
    MOVING = 1
    INFINITY = 2


class MotionStatus(IntEnum):
    """What a key frame pair tells of the camera's motion."""

    UNKNOWN = 0
    MOVING = 1
    STANDSTILL = 2
    ROTATION_ONLY = 3


class ScalePrior(IntEnum):
    """What settled the size of a moving plane, which two views leave open, see docs/papers.md."""

    NONE = 0
    GROUND_CONTACT = 1
    SMALLEST_MOTION = 2


class ScaleStatus(IntEnum):
    """In which unit positions are given."""

    UNKNOWN = 0
    METRIC = 1


class TrackingStatus(IntEnum):
    """How far the pose of a key frame can be trusted."""

    INITIALISING = 0
    OK = 1
    PREDICTED = 2
    LOST = 3


WITH_POSE = TrackingStatus.OK, TrackingStatus.PREDICTED  # a pose is published then


class ObstacleState(IntEnum):
    """Life of a track."""

    TENTATIVE = 0
    CONFIRMED = 1
    COASTING = 2


@dataclass(frozen=True)
class Correspondences:
    """Merged motion vectors of a key frame pair, (1) of [MVO].

    Attributes
    ----------
    stamp, previous_stamp : int
        Times of key frame k and of the key frame before it [ns].
    width, height : int
        Picture size [px].
    kind, n_b, reason : SegmentKind, int, str
        How the pair is joined, B frames between, and why a BROKEN one is (else empty).
    x_cur, x_prev : (N, 2) float32
        Block centres in both key frames [px], with the lens' distortion still in.
    sigma : (N,) float32
        Standard deviation of each coordinate of ``x_prev``, Lemma 2 of [SLAPSE] [px].
    probability : (N,) float32
        Probability that a right vector is among the evidence, Lemma 1 of [SLAPSE].
    block : (N, 2) uint8
        Width and height of the block [px].
    strips : StripMatches, on the way ahead, over a longer while
    """

    stamp: int
    previous_stamp: int
    width: int
    height: int
    kind: SegmentKind
    n_b: int = 0
    reason: str = ''
    x_cur: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    x_prev: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    sigma: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    probability: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    block: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.uint8))
    strips: StripMatches = StripMatches()

    def __len__(self) -> int:
        """Return the number of correspondences."""
        return len(self.x_cur)

    @property
    def lone(self) -> np.ndarray:
        """Return which (N,) bool nothing supports: at most half as probable as the best one."""
        return self.probability < 0.5 * self.probability.max(initial=0)

    def supported(self) -> 'Correspondences':
        """Return the pair without lone vectors."""
        keep, columns = ~self.lone, ('x_cur', 'x_prev', 'sigma', 'probability', 'block')
        return replace(self, **{name: getattr(self, name)[keep] for name in columns})


@dataclass(frozen=True)
class CameraMotion:
    """Motion of the camera between two key frames, X_cur = R X_prev + t.

    Attributes
    ----------
    status : MotionStatus
        Whether there is a motion, and of what kind.
    R_cur_from_prev : (3, 3) float64
        Rotation.
    t_cur_from_prev : (3,) float64
        Direction of translation, a unit vector: the baseline is the unit of length of the pair
        (zero where the camera does not move).
    covariance : (6, 6) float64
        Of (rotation [rad], direction), rotation as a left perturbation exp(w) R; the direction's
        part is singular along itself.
    forward : bool
        The vote of [MVO] 4.2: the camera moves along its optical axis rather than against it.
    """

    status: MotionStatus
    R_cur_from_prev: np.ndarray = field(default_factory=np.eye(3).copy)
    t_cur_from_prev: np.ndarray = field(default_factory=lambda: np.zeros(3))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((6, 6)))
    forward: bool = True


@dataclass(frozen=True)
class PlaneObservation:
    """A plane seen in one key frame pair; lengths in units of the pair's baseline.

    Attributes
    ----------
    id : int
        Lasts while the plane is followed, also through a change of label. Of one that may move
        it is below -1, and of this pair alone.
    label : Label
        STATIONARY or MOVING, Definition 2 of [MVO]; UNKNOWN: half as sure that it moves.
    plane : (3,) float64
        n / d in the camera of key frame k, plane @ X = -1 [1/baseline].
    covariance : (3, 3) or (6, 6) float64
        Of ``plane``; of one that moves or may move of (plane, t_d).
    t_d : (3,) float64
        Displacement of a moving plane from k to k-1 in camera k, (11) of [MVO] [baseline].
    product : (3, 3) float64
        (t - t_d) plane^T of a moving plane, the part that two views do observe.
    scale_prior : ScalePrior
        What settled the gauge between ``plane`` and ``t_d``.
    is_ground : bool
        The plane the camera rides on.
    n_macroblocks : int
        Correspondences that support it.
    score : float, how much rather a mover moves than not: chi-square, all pairs
    """

    id: int
    label: Label
    plane: np.ndarray
    covariance: np.ndarray
    t_d: np.ndarray = field(default_factory=lambda: np.zeros(3))
    product: np.ndarray = field(default_factory=lambda: np.zeros((3, 3)))
    scale_prior: ScalePrior = ScalePrior.NONE
    is_ground: bool = False
    n_macroblocks: int = 0
    score: float = 0.0


@dataclass(frozen=True)
class Extraction:
    """What one key frame pair shows: camera motion, labelled planes, labelled macroblocks.

    Attributes
    ----------
    stamp, previous_stamp, width, height, kind : see Correspondences
    reason : str, why the motion is unknown, else empty
    K : (3, 3) float64
        Intrinsics of the undistorted pixels below [px].
    motion : CameraMotion
    planes : tuple of PlaneObservation
    x_cur, x_prev : (N, 2) float32
        Correspondences [px], undistorted.
    sigma : (N,) float32
        Standard deviation of a coordinate [px].
    block : (N, 2) uint8
        Block size [px].
    label : (N,) int8
        Label of each correspondence; a wrong vector is UNKNOWN.
    plane_id : (N,) int32
        Plane each belongs to, -1 for none; below: of a plane that may move.
    macroblock_label, macroblock_plane : (M,) int8, (M,) int32
        Label and plane of each 16x16 macroblock of the picture, row by row, -1 for none. What a
        mover covers is its own, also without a vector.
    baseline_ratio, baseline_ratio_sigma : float
        log(|t| / |t| of the last pair with a baseline) by the map; standard deviation, inf: none.
    """

    stamp: int
    previous_stamp: int
    width: int
    height: int
    kind: SegmentKind
    K: np.ndarray
    motion: CameraMotion
    planes: tuple[PlaneObservation, ...] = ()
    reason: str = ''
    x_cur: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    x_prev: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.float32))
    sigma: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    block: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.uint8))
    label: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int8))
    plane_id: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    macroblock_label: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int8))
    macroblock_plane: np.ndarray = field(default_factory=lambda: np.zeros(0, np.int32))
    baseline_ratio: float = 0.0
    baseline_ratio_sigma: float = float('inf')


@dataclass(frozen=True)
class MapPlane:
    """A stationary plane of the map in {W}.

    Attributes
    ----------
    id : int
    normal, depth : (3,) float64, float
        normal @ X + depth = 0 [map unit].
    covariance : (4, 4) float64
        Of (normal, depth), tangential to the unit sphere in the normal.
    outline : (M, 3) float64
        Convex outline of the macroblocks seen on it, of 32 corners at most.
    first_stamp, last_stamp, n_observations : int
        When first and last seen [ns]; in how many key frames.
    n_macroblocks : int
        In the newest key frame; 0 where not seen.
    is_ground : bool
    """

    id: int
    normal: np.ndarray
    depth: float
    covariance: np.ndarray
    outline: np.ndarray
    first_stamp: int
    last_stamp: int
    n_observations: int
    n_macroblocks: int = 0
    is_ground: bool = False


@dataclass(frozen=True)
class SceneEstimate:
    """Camera and map after one key frame.

    Attributes
    ----------
    stamp : int
    status, reason : TrackingStatus, str
    R_world_from_cam, t_world_from_cam : (3, 3), (3,) float64
        Pose, X_W = R X_cam + t.
    pose_covariance : (6, 6) float64
        Of (position in {W}, rotation [rad] about the axes of {W}: exp(w) R).
    velocity_world, omega_cam, twist_covariance : (3,), (3,), (6, 6) float64
        Velocity in {W} [unit/s], angular velocity in the camera [rad/s]; covariance of both.
    scale_status, scale_source : ScaleStatus, str
        Unit of length and where it comes from.
    planes, baseline : tuple of MapPlane, float
        The map; distance between the pair's key frames [map unit].
    resets, repairs, unit : int, int, float
        How often {W} began anew, after a loss, and the covariance had to be put right; what was 1
        when the map began [map unit]. All lengths change with it, about the last published place.
    """

    stamp: int
    status: TrackingStatus
    reason: str
    R_world_from_cam: np.ndarray
    t_world_from_cam: np.ndarray
    pose_covariance: np.ndarray
    velocity_world: np.ndarray
    omega_cam: np.ndarray
    twist_covariance: np.ndarray
    scale_status: ScaleStatus
    scale_source: str
    planes: tuple[MapPlane, ...] = ()
    baseline: float = 0.0
    resets: int = 0
    repairs: int = 0
    unit: float = 1.0


@dataclass(frozen=True)
class Obstacle:
    """A moving obstacle after one key frame.

    Attributes
    ----------
    id, stamp, state : int, int, ObstacleState
    plane : (3,) float64
        n / d in {W} [1/map unit].
    position, velocity : (3,) float64
        Centre of the seen surface and its velocity, in {W} [map unit, per second].
    covariance : (6, 6) float64
        Of (position, velocity).
    time_to_contact, time_to_contact_variance : float
        [s], [s^2]; infinite where the distance does not shrink.
    box : (4,) float64
        x, y of the top left corner, width, height in the picture [px].
    outline : (M, 3) float64
        Seen surface in {W}.
    n_macroblocks : int
    age, last_seen : float, int
        Time since the first detection [s], stamp of the last evidence [ns].
    scale_prior : ScalePrior
    """

    id: int
    stamp: int
    state: ObstacleState
    plane: np.ndarray
    position: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray
    time_to_contact: float
    time_to_contact_variance: float
    box: np.ndarray
    outline: np.ndarray
    n_macroblocks: int
    age: float
    last_seen: int
    scale_prior: ScalePrior


@dataclass(frozen=True)
class Speed:
    """Speed [m/s] of the vehicle at a stamp, by its wheels or whatever; negative backwards."""

    stamp: int
    value: float


@dataclass(frozen=True)
class PlaneHandover:
    """A plane that changes its label and so its filter, plane management of [MVO] 5.

    Attributes
    ----------
    stamp, id : int, int
    to_label : Label
        STATIONARY: from the obstacle tracker to the scene filter; MOVING: the other way.
    plane : (3,) float64
        n / d in {W} [1/map unit].
    velocity : (3,) float64
        In {W} [map unit/s].
    covariance : (6, 6) float64
        Of (plane, velocity).
    """

    stamp: int
    id: int
    to_label: Label
    plane: np.ndarray
    velocity: np.ndarray
    covariance: np.ndarray
