"""State (13) of the scene filter: two camera poses, velocities and stationary planes.

Departures from [MVO]: rotations err on SO(3), R_world_from_cam = R exp(theta) with theta in the
camera; the previous key frame's pose stays in the state (a stochastic clone), since a
correspondence relates two poses; a plane is n / d about an anchor, the camera centre at its
birth, with axes of {W}, so that it is never singular.
"""

from dataclasses import dataclass, field
import itertools

from mv_slapse.config import SceneSettings
from mv_slapse.filters import ekf
from mv_slapse.geometry import rotation
from mv_slapse.geometry.rotation import norm
import numpy as np

# Errors that are not estimated: turn by which all vectors err, place in their blocks that they
# tell of, camera height, speed that is given, focal length, and the map's unit after turns.
TURN, PLACE, HEIGHT, SPEED = slice(0, 3), slice(3, 5), slice(5, 6), slice(6, 7)
FOCAL, LENGTH = 7, 8
N_LASTING = LENGTH + 1
# Where the blocks of the camera begin in the error state; they are the first and stay.
CUR, VEL, OM, CAMERA = 6, 12, 15, 18
THETA, PLACE_NOW = slice(CUR, CUR + 3), slice(CUR + 3, VEL)
UNIT, UNIT_POSE = np.eye(3), np.eye(6)  # made once: numpy takes 5 us for one
# Elements of the noise of a motion: where a place and its velocity, a turn and its rate meet.
NOISY = tuple(np.add.outer(at, range(3)).ravel() for at in zip(
    *itertools.product((CUR + 3, VEL), repeat=2), *itertools.product((CUR, OM), repeat=2),
    strict=True))


@dataclass
class Pose:
    """R_world_from_cam (3, 3) and t_world_from_cam (3,)."""

    R: np.ndarray
    t: np.ndarray

    def copy(self) -> 'Pose':
        """Return an independent copy."""
        return Pose(self.R.copy(), self.t.copy())

    def moved(self, e: np.ndarray) -> 'Pose':
        """Return it moved by an error (6,)."""
        return Pose(self.R @ rotation.exp(e[:3]), self.t + e[3:])


@dataclass
class AnchoredPlane:
    """A plane n / d in a frame with axes of {W} and its origin at ``anchor`` (3,) in {W}."""

    plane: np.ndarray
    anchor: np.ndarray


@dataclass
class Gauge:
    """How the whole scene lies in {W}, where it has begun anew at a ``place`` (3,).

    ``covariance`` (7, 7) of a turn about that place, axes of {W} [rad], of a shift, and of the log
    of all lengths.
    """

    place: np.ndarray = field(default_factory=lambda: np.zeros(3))
    covariance: np.ndarray = field(default_factory=lambda: np.zeros((7, 7)))


@dataclass
class SceneState:
    """Nominal values and the covariance of their errors.

    Errors: of a pose (theta [rad] in the camera, position in {W}); of velocity and planes
    additive; of ``mount``, the ground normal as the camera is mounted, and of ``depth_scale``, the
    log of the baseline that the depths of the last pair amount to, additive; of ``heave``, the
    camera's height above the road that is seen over what it is in the mean, as a share, additive.
    """

    previous: Pose
    current: Pose
    velocity: np.ndarray
    omega: np.ndarray
    mount: np.ndarray
    depth_scale: float = 0.0
    heave: float = 0.0
    planes: dict[int, AnchoredPlane] = field(default_factory=dict)
    error: ekf.State = field(default_factory=lambda: ekf.State(N_LASTING))
    gauge: Gauge = field(default_factory=Gauge)

    @property
    def size(self) -> int:
        """Return the length of the error state."""
        return len(self.error.mu)

    @property
    def P(self) -> np.ndarray:
        """Return the covariance of the error state."""
        return self.error.P

    @property
    def arrays(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the values as the kernels take them: camera (29,), planes, anchors (P, 3).

        The camera's: R and t of the previous and of the current pose, mount, depth_scale, heave.
        """
        camera = np.concatenate([
            self.previous.R.ravel(), self.previous.t, self.current.R.ravel(), self.current.t,
            self.mount, (self.depth_scale, self.heave)])
        return camera, *self.anchored

    @property
    def anchored(self) -> tuple[np.ndarray, np.ndarray]:
        """Return planes and anchors as the kernels take them, (P, 3) each."""
        planes = self.planes.values()
        return (np.array([p.plane for p in planes]).reshape(-1, 3),
                np.array([p.anchor for p in planes]).reshape(-1, 3))

    def positions(self, ids) -> np.ndarray:
        """Return where planes stand in ``arrays``, (len(ids),) int64."""
        place = {id: k for k, id in enumerate(self.planes)}
        return np.array([place[id] for id in ids], np.int64)

    def at(self, name) -> slice:
        """Return where a block lies in the error state."""
        return self.error.index(name)

    def add_plane(self, id: int, plane: AnchoredPlane, covariance: np.ndarray):
        """Add a plane that is independent of the rest."""
        self.planes[id] = plane
        self.error.add(id, np.zeros(3), covariance)

    def remove_plane(self, id: int):
        """Marginalise a plane out."""
        del self.planes[id]
        self.error.remove(id)

    def moved(self, e: np.ndarray) -> 'SceneState':
        """Return the nominal values moved by an error (n,); the covariance is shared."""
        pose = {name: getattr(self, name).moved(e[self.at(name)])
                for name in ('previous', 'current')}
        planes = {id: AnchoredPlane(p.plane + e[self.at(id)], p.anchor)
                  for id, p in self.planes.items()}
        mount = self.mount + e[self.at('mount')]
        return SceneState(
            pose['previous'], pose['current'], self.velocity + e[self.at('velocity')],
            self.omega + e[self.at('omega')], mount / norm(mount),
            self.depth_scale + float(e[self.at('depth_scale')][0]),
            self.heave + float(e[self.at('heave')][0]), planes, self.error, self.gauge)

    def error_to(self, other: 'SceneState') -> np.ndarray:
        """Return the error (n,) that moves the camera's poses to another state's."""
        e = np.zeros(self.size)
        for name in ('previous', 'current'):
            mine, theirs = getattr(self, name), getattr(other, name)
            e[self.at(name)] = np.concatenate(
                (rotation.log(mine.R.T @ theirs.R), theirs.t - mine.t))
        return e


def start(mount: np.ndarray, velocity_sigma: float, omega_sigma: float,
          mount_sigma: float) -> SceneState:
    """Return the state at the first key frame, which is {W}; its pose is known exactly."""
    state = SceneState(Pose(np.eye(3), np.zeros(3)), Pose(np.eye(3), np.zeros(3)), np.zeros(3),
                       np.zeros(3), mount)
    for name, n, sigma in (('previous', 6, 0.0), ('current', 6, 0.0),
                           ('velocity', 3, velocity_sigma), ('omega', 3, omega_sigma),
                           ('mount', 3, mount_sigma), ('depth_scale', 1, 0.0), ('heave', 1, 0.0)):
        state.error.add(name, np.zeros(n), np.eye(n) * sigma**2)
    return state


def propagate(state: SceneState, dt: float, acceleration: float, angular_acceleration: float,
              turn_rate: float):
    """Clone the current pose and move the camera by dt [s] at constant velocity.

    White noise of acceleration [unit/s^1.5] and angular acceleration [rad/s^1.5] densities
    enters the velocities and, integrated, the pose. The angular velocity is forgotten at the rate
    at which its standard deviation never exceeds ``turn_rate`` [rad/s] (Ornstein-Uhlenbeck).
    """
    rate = 0.5 * (angular_acceleration / turn_rate)**2
    left, reach = np.exp(-rate * dt), -np.expm1(-rate * dt) / rate if rate else dt
    turn = rotation.exp(state.omega * reach)
    F = np.zeros((CAMERA, state.size))
    F[:CUR, CUR:VEL] = UNIT_POSE
    F[THETA, THETA], F[PLACE_NOW, PLACE_NOW], F[VEL:OM, VEL:OM] = turn.T, UNIT, UNIT
    F[THETA, OM:CAMERA], F[OM:, OM:CAMERA] = reach * UNIT, left * UNIT
    F[PLACE_NOW, VEL:OM] = dt * UNIT
    Q = np.zeros((CAMERA, CAMERA))
    Q[NOISY] = [density**2 * moment for density, lost in ((acceleration, 0.0),
                                                          (angular_acceleration, rate))
                for moment in _moments(dt, lost) for _ in range(3)]
    state.previous = state.current.copy()
    state.current = Pose(state.current.R @ turn, state.current.t + state.velocity * dt)
    state.omega = left * state.omega
    ekf.predict_rows(state.error, np.arange(CAMERA), F, Q)


def _moments(dt: float, rate: float) -> tuple[float, float, float, float]:
    """Return the covariance (2, 2) of the integral of a process after dt [s] and of the process.

    One of Ornstein and Uhlenbeck with unit noise, which forgets at a rate [1/s]; 0: a random walk.
    """
    if not rate:
        return dt**3 / 3, dt**2 / 2, dt**2 / 2, dt
    reach, variance = -np.expm1(-rate * dt) / rate, -np.expm1(-2 * rate * dt) / (2 * rate)
    return (dt - 2 * reach + variance) / rate**2, reach**2 / 2, reach**2 / 2, variance


def doubt_speed(state: SceneState):
    """Let the velocity be unsure by all of itself: of a pair in which the camera started.

    Its mean over the pair is seen; at the end of it the camera may be twice as fast.
    """
    at = state.at('velocity')
    state.error.P[at, at] += np.outer(state.velocity, state.velocity)


def doubt_way(state: SceneState, place: np.ndarray):
    """Let the position be unsure by all of the way from a place (3,) in {W}."""
    way = state.current.t - place
    state.error.P[PLACE_NOW, PLACE_NOW] += np.outer(way, way)


def halt(state: SceneState, omega: np.ndarray, covariance: np.ndarray):
    """Set the velocity to zero and the angular velocity (3,) [rad/s] with its covariance (3, 3).

    Both are seen, whatever was predicted: a stop may be too sudden for a random walk.
    """
    for name, seen in (('velocity', UNIT * 1e-4), ('omega', covariance)):
        at = state.at(name)
        state.error.P[at], state.error.P[:, at], state.error.lasting[at] = 0, 0, 0
        state.error.P[at, at] = seen
    state.velocity, state.omega = np.zeros(3), omega


def stretched(vectors: np.ndarray) -> np.ndarray:
    """Return the growth of vectors (..., 3) of a camera with a focal length that is too short.

    For each share by which it is: what lies across the view seems so much farther across, and
    turns seem larger, but for what the size of the picture makes of second order.
    """
    return vectors * np.array([1.0, 1.0, 0.0])


def turn_on_the_spot(state: SceneState, R_cur_from_prev: np.ndarray, covariance: np.ndarray,
                     sigma: float, focal_sigma: float = 0.0):
    """Clone the pose and turn it; covariance (3, 3) of the turn, sigma [unit] of the place.

    ``focal_sigma`` is the standard deviation of the focal length, as a share.
    """
    F, Q = np.zeros((VEL, state.size)), np.zeros((VEL, VEL))
    F[:CUR, CUR:VEL] = F[CUR:, CUR:VEL] = UNIT_POSE
    F[THETA, THETA], Q[THETA, THETA] = R_cur_from_prev, covariance
    Q[PLACE_NOW, PLACE_NOW] = UNIT * sigma**2
    state.previous = state.current.copy()
    state.current = Pose(state.current.R @ R_cur_from_prev.T, state.current.t.copy())
    ekf.predict_rows(state.error, np.arange(VEL), F, Q)
    state.error.lasting[THETA, FOCAL] -= focal_sigma * stretched(rotation.log(R_cur_from_prev))


def plane_in_camera(state: SceneState, id: int) -> np.ndarray:
    """Return a plane n / d in the current camera, (16) of [MVO]."""
    plane, pose = state.planes[id], state.current
    return pose.R.T @ plane.plane / (1 + plane.plane @ (pose.t - plane.anchor))


def sway(state: SceneState, dt: float, settings: SceneSettings):
    """Let the heave, which is a share of the height and lasts for a while, settle for dt [s]."""
    sigma, time = settings.camera_height_sigma, settings.camera_height_time
    at = state.at('heave').start
    left = np.exp(-dt / time) if time else 0.0
    F = np.zeros((1, state.size))
    F[0, at] = left
    state.heave *= left
    ekf.predict_rows(state.error, np.array([at]), F,
                     np.array([[sigma**2 * (1 - left**2)]]))


def relative_motion(state: SceneState):
    """Return R_cur_from_prev, t_cur_from_prev of the two poses of the state."""
    R_cam_from_world = state.current.R.T
    return (R_cam_from_world @ state.previous.R,
            R_cam_from_world @ (state.previous.t - state.current.t))


def scale_lengths(state: SceneState, factor: float):
    """Multiply every length of the state by a factor: the unit of length has become known."""
    D = np.ones(state.size)
    for name in ('previous', 'current'):
        D[state.at(name).start + 3:state.at(name).stop] = factor
        getattr(state, name).t *= factor
    D[state.at('velocity')] = factor
    state.velocity = state.velocity * factor
    state.depth_scale += np.log(factor)
    for id, plane in state.planes.items():
        D[state.at(id)] = 1 / factor
        plane.plane, plane.anchor = plane.plane / factor, plane.anchor * factor
    unit = np.r_[1, 1, 1, factor, factor, factor, 1]
    state.gauge = Gauge(factor * state.gauge.place, unit[:, None] * state.gauge.covariance * unit)
    state.error.P = D[:, None] * state.error.P * D
    state.error.lasting = D[:, None] * state.error.lasting


def rescale_about(state: SceneState, place: np.ndarray, factor: float, sigma: float):
    """Multiply every length by a factor that is sure to ``sigma``, so that a place (3,) stays.

    What has been told of the way to that place, in another unit, is as wrong as the place was.
    """
    _translate(state, -place)
    scale_lengths(state, factor)
    widen_scale(state, sigma)
    _translate(state, place)
    state.gauge.covariance[3:6, 3:6] += (1 - factor)**2 * np.outer(place, place)


def _translate(state: SceneState, by: np.ndarray):
    """Move the scene in {W}; errors, all relative to where it is, stay."""
    for pose in (state.previous, state.current):
        pose.t = pose.t + by
    for known in state.planes.values():
        known.anchor = known.anchor + by
    state.gauge = Gauge(state.gauge.place + by, state.gauge.covariance)


def widen_scale(state: SceneState, sigma: float):
    """Add a common error of all lengths, as a share of them, to the covariance."""
    e = np.zeros(state.size)
    for name in ('previous', 'current'):
        e[state.at(name).start + 3:state.at(name).stop] = getattr(state, name).t
    e[state.at('velocity')] = state.velocity
    e[state.at('depth_scale')] = 1
    for id, known in state.planes.items():
        # The anchor stays where it is, and the plane moves against it.
        e[state.at(id)] = -known.plane * (1 - known.plane @ known.anchor)
    state.error.P += sigma**2 * np.outer(e, e)


def log_baseline(state: SceneState) -> tuple[float, np.ndarray]:
    """Return the log of the distance between the two poses and its derivative (n,)."""
    prev, cur = state.at('previous'), state.at('current')
    offset = state.current.t - state.previous.t
    square = max(float(offset @ offset), 1e-18)
    H = np.zeros(state.size)
    H[cur.start + 3:cur.stop] = offset / square
    H[prev.start + 3:prev.stop] = -offset / square
    return 0.5 * np.log(square), H


def move_anchor(state: SceneState, id: int, anchor: np.ndarray):
    """Express a plane about another anchor (3,) in {W}; what is known of it stays the same."""
    old = state.planes[id]
    offset = anchor - old.anchor
    scale = 1 + old.plane @ offset
    at, F = state.at(id), np.zeros((3, state.size))
    F[:, at] = UNIT / scale - np.outer(old.plane, offset) / scale**2
    state.planes[id] = AnchoredPlane(old.plane / scale, anchor.copy())
    ekf.predict_rows(state.error, np.arange(at.start, at.stop), F, np.zeros((3, 3)))


def renew(state: SceneState, relief: float):
    """Let all planes change as the camera moves on and sees other parts of the surfaces.

    Their depths walk by ``relief``, a share of them, while the camera moves by its distance from
    the plane: a surface is no plane, and each part of it departs by so much.
    """
    plane, anchor = state.anchored
    above = 1 + (plane * (state.current.t - anchor)).sum(axis=1)
    distance = np.abs(above) / np.sqrt((plane * plane).sum(axis=1))
    way = norm(state.current.t - state.previous.t)
    share = way / np.maximum(way, distance)
    at = state.size - plane.size + np.arange(plane.size).reshape(-1, 3)
    state.error.P[at[:, :, None], at[:, None]] += (
        relief**2 * share[:, None, None] * plane[:, :, None] * plane[:, None])


def bend(state: SceneState, id: int, sigma: float):
    """Let a plane's normal walk by ``sigma`` [rad] about its anchor, where its depth stays."""
    at, plane = state.at(id), state.planes[id].plane
    state.error.P[at, at] += sigma**2 * (plane @ plane * UNIT - np.outer(plane, plane))
