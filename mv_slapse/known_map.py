"""Where a new run lies in the map of an earlier one: the pose at which planes are found again.

A plane tells three numbers of a pose: two of its normal and its distance. They are compared as in
[SLAPSE] VI, weighted by the covariances of both maps, and added to what is known beforehand: about
where the run began. Nothing tells planes apart but where they lie, so a plane counts only where
one alone of the known ones can be meant.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field

from mv_slapse.geometry import rotation
from mv_slapse.geometry.plane import WELL_SEEN
from mv_slapse.records import MapPlane, ScaleStatus, SceneEstimate
from mv_slapse.ros_frames import Pose
import numpy as np

#: of a start of which nothing is known but that it is about where the earlier run began
START_SIGMA = (10.0, 10.0, 10.0, 0.35, 0.35, 0.35)  # [m], [rad]
FLOOR = (0.02, 0.02, 0.1)  # [rad], [m]: walls are no planes, and the maps' errors are not all told
ROAD = 0.005  # [rad/m^0.5] random walk of a road's normal, as scene.ground_slope
GATE = 11.3  # chi-square of 3 degrees of freedom, 1 %
MISFIT = 2.0  # mean chi-square of a number above which the planes found contradict one another
ALIKE = 0.5  # cosine between normals beyond which no error of the start makes two planes one
ONE = (0.1, 0.1, 1.0)  # [rad], [m] within which planes of one map are one surface, seen twice
APART = 5.0  # [m] beyond its outline in which a plane may go on
WALLS = 3  # two tell the place, and nothing would tell another corner from it
TOLD = 0.5  # by which the planes must shrink the start's standard deviation in every direction
ROUNDS = 5
PERIOD = 1_000_000_000  # [ns] between two looks: the map of a run changes slowly
LEAST = 1e-6  # [m^2], [rad^2] of a start that somebody calls exact


@dataclass(frozen=True)
class KnownMap:
    """The planes of an earlier run, in its {W}, and whether their unit is the metre."""

    planes: tuple[MapPlane, ...]
    is_metric: bool


@dataclass(frozen=True)
class Placing:
    """How a run lies in a known map.

    Attributes
    ----------
    known_from_world : Pose or None
        Pose of the run's {W} in that of the map, covariance of (position, rotation); None where
        the planes do not tell it.
    matches : tuple of (int, int)
        Ids of planes of the run and of the map that are one.
    reason : str
        Why there is no pose.
    """

    known_from_world: Pose | None
    matches: tuple[tuple[int, int], ...] = ()
    reason: str = ''

    @property
    def position_sigma(self) -> float:
        """Return the standard deviation of the position found [map unit]."""
        return float(np.sqrt(np.trace(self.known_from_world.covariance[:3, :3])))


@dataclass(frozen=True)
class _Problem:
    """The start, and pairs of planes, of the run and known, that are taken for one."""

    start: Pose
    pairs: tuple[tuple[MapPlane, MapPlane], ...] = field(default=())


def about(pose: Pose | None = None) -> Pose:
    """Return a pose, by default the origin, that is known as badly as a start is."""
    covariance = np.diag(np.square(START_SIGMA))
    return Pose(np.eye(3), np.zeros(3), covariance) if pose is None else Pose(
        pose.R, pose.t, covariance)


def place(known: KnownMap, scene: SceneEstimate, start: Pose) -> Placing:
    """Find the planes of a scene again in a known map.

    Parameters
    ----------
    known : KnownMap
    scene : SceneEstimate
        Of the run, with its map.
    start : Pose
        Pose of the run's {W} in that of the map as far as it is known beforehand, covariance
        of (position, rotation about the map's axes).

    Returns
    -------
    placing : Placing
        Without a pose where the planes do not tell it in every direction, or contradict one
        another.
    """
    if not (known.is_metric and scene.scale_status is ScaleStatus.METRIC):
        whose = 'this run' if known.is_metric else 'the map'
        return Placing(None, reason=f'the scale of {whose} is not known, lengths cannot be '
                       'compared')
    start = Pose(start.R, start.t, start.covariance + LEAST * np.eye(6))
    problem, pose = _Problem(start), start
    theirs = _Surfaces(known.planes)
    waiting, found, taken = _Surfaces(scene.planes).planes, True, set()
    while found:
        found = False
        for plane in waiting:
            meant = theirs.meant(pose, plane)
            # a surface seen as several planes tells no more than once
            if meant and meant[0].id not in taken and all(
                    _is_one(meant[0], other) for other in meant):
                taken.add(meant[0].id)
                problem = _Problem(start, (*problem.pairs, (plane, meant[0])))
                pose, found = _solve(problem), True
        waiting = [p for p in waiting if all(p.id != ours.id for ours, _ in problem.pairs)]
    return _judged(problem, pose)


class _Surfaces:
    """The planes of a map that were seen well, the best first."""

    def __init__(self, planes: Sequence[MapPlane]):
        well = [p for p in planes if p.n_observations >= WELL_SEEN and len(p.outline)]
        self.planes = sorted(well, key=lambda plane: -plane.n_observations)
        self._normals = np.array([plane.normal for plane in self.planes]).reshape(-1, 3)
        self._centres = np.array([p.outline.mean(0) for p in self.planes]).reshape(-1, 3)
        self._is_ground = np.array([plane.is_ground for plane in self.planes], bool)
        self._reaches = np.array([_reach(plane.outline) for plane in self.planes])

    def meant(self, pose: Pose, ours: MapPlane) -> list[MapPlane]:
        """Return those that a plane of the run may be, as far as the pose is known."""
        outline = ours.outline @ pose.R.T + pose.t
        unsure = 3 * np.sqrt(np.linalg.eigvalsh(pose.covariance[:3, :3]).max())
        between = np.linalg.norm(self._centres - outline.mean(0), axis=1)
        near = between <= self._reaches + _reach(outline) + APART + unsure
        near &= self._normals @ (pose.R @ ours.normal) > ALIKE
        near &= self._is_ground == ours.is_ground
        return [self.planes[i] for i in np.flatnonzero(near)
                if _distance(pose, ours, self.planes[i]) < GATE]


def _judged(problem: _Problem, pose: Pose) -> Placing:
    matches = tuple((ours.id, known.id) for ours, known in problem.pairs)
    if not matches:
        return Placing(None, reason='no plane of the map is found again, or more than one could '
                       'be meant')
    misfit = sum(_chi_square(pose, *pair) for pair in problem.pairs) / (3 * len(matches))
    if misfit > MISFIT:
        return Placing(None, matches, 'the planes that could be meant contradict one another')
    whiten = np.linalg.inv(np.linalg.cholesky(problem.start.covariance))
    left = np.linalg.eigvalsh(whiten @ pose.covariance @ whiten.T).max()
    if left > TOLD**2:
        return Placing(None, matches, f'{len(matches)} planes are found again, which do not tell '
                       'the place in every direction, as planes that are parallel do not')
    walls = sum(not known.is_ground for _, known in problem.pairs)
    if walls < WALLS:
        return Placing(None, matches, f'{walls} walls are found again, {WALLS} are needed to tell '
                       'a place from another one')
    return Placing(pose, matches)


def _solve(problem: _Problem) -> Pose:
    """Return the pose that agrees best with the start and all pairs, by Gauss and Newton."""
    start, pose = problem.start, problem.start
    prior = np.linalg.inv(start.covariance)
    for _ in range(ROUNDS):
        from_start = np.r_[pose.t - start.t, rotation.log(pose.R @ start.R.T)]
        information, gradient = prior.copy(), prior @ from_start
        for pair in problem.pairs:
            residual, J, noise = _compared(pose, *pair)
            weight = J.T @ np.linalg.inv(noise)
            information += weight @ J
            gradient += weight @ residual
        step = -np.linalg.solve(information, gradient)
        pose = Pose(rotation.exp(step[3:]) @ pose.R, pose.t + step[:3],
                    np.linalg.inv(information))
    return pose


def _is_one(plane: MapPlane, other: MapPlane) -> bool:
    """Return whether two planes of a map are one surface, seen twice."""
    residual, _, _ = _compared(Pose(np.eye(3), np.zeros(3)), other, plane)
    return bool(plane.normal @ other.normal > 0 and np.all(np.abs(residual) < ONE))


def _distance(pose: Pose, ours: MapPlane, known: MapPlane) -> float:
    """Return the squared Mahalanobis distance of two planes, the pose's error included."""
    residual, J, noise = _compared(pose, ours, known)
    return float(residual @ np.linalg.solve(noise + J @ pose.covariance @ J.T, residual))


def _chi_square(pose: Pose, ours: MapPlane, known: MapPlane) -> float:
    residual, _, noise = _compared(pose, ours, known)
    return float(residual @ np.linalg.solve(noise, residual))


def _reach(outline: np.ndarray) -> float:
    """Return how far (M, 3) points lie from their middle at most."""
    return float(np.linalg.norm(outline - outline.mean(0), axis=1).max())


def _compared(pose: Pose, ours: MapPlane, known: MapPlane
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return by how much (3,) a plane misses a known one, its Jacobian (3, 6), and its noise.

    Two angles, and the distance at the middle of what was seen of the known one.
    """
    R, t, centre = pose.R, pose.t, known.outline.mean(0)
    normal = R @ ours.normal
    across = np.linalg.svd(known.normal[None])[2][1:]  # (2, 3), at right angles to the normal
    to_map = np.block([[R, np.zeros((3, 1))], [-(t @ R), np.ones((1, 1))]])
    to_residual = np.block([[across, np.zeros((2, 1))], [centre, np.ones((1, 1))]])
    moved = to_map @ np.r_[ours.normal, ours.depth]
    residual = to_residual @ (moved - np.r_[known.normal, known.depth])
    J = np.zeros((3, 6))
    J[:2, 3:] = -across @ rotation.skew(normal)
    J[2, :3], J[2, 3:] = -normal, np.cross(normal, centre - t)
    noise = to_residual @ (to_map @ ours.covariance @ to_map.T + known.covariance) @ to_residual.T
    return residual, J, noise + np.diag(_roughness(ours, known))


def _roughness(ours: MapPlane, known: MapPlane) -> np.ndarray:
    """Return variances (3,) by which one surface differs from plane to plane.

    A road bends on the way from where one map has it to where the other has.
    """
    if not known.is_ground:
        return np.square(FLOOR)
    way = 2 * max(_reach(ours.outline), _reach(known.outline))
    return np.square(FLOOR) + ROAD**2 * way * np.array([1.0, 1.0, way**2 / 3])
