"""The ground plane: below the camera, nearly level, and hard to see.

Road texture is weak and moves fast, so most of its vectors may be wrong and the largest consensus
in the lower picture may be a wrong one. What is known helps: its normal hardly changes from one
key frame to the next, and next to nothing lies below it.
"""

from dataclasses import dataclass
import math

from mv_slapse.changed import replace
from mv_slapse.config import ExtractionSettings
from mv_slapse.geometry import plane as plane_geometry
from mv_slapse.geometry.blocks import MACROBLOCK
from mv_slapse.geometry.camera import UP
from mv_slapse.geometry.rotation import norm
from mv_slapse.kernels.binding import compiled
from mv_slapse.motion.observations import BlockObservations, Depths
from mv_slapse.surfaces import height
from mv_slapse.surfaces.height import HeightBelief, RoadBlocks
from mv_slapse.surfaces.plane_search import PlaneFit
import numpy as np

HEIGHT_WOBBLE = 0.02  # change of log(height) between key frames: suspension and slope
FORGOTTEN = 0.3  # spread of log(depth) beyond which the ground is looked for afresh
GUESSED = 1.0  # the same of a ground that none shows, for movers: within a factor of 7.4
FARTHEST = 2.0  # standard deviations by which that ground may lie farther, or nearer
MISSED = 2  # pairs without it after which a ground that many pairs contradict is believed no more
IN_VIEW = 0.9  # cosine of the course to the axis, 26 degrees; beyond, few cameras see it
LEARNING = 0.1  # share that one key frame has in the learned mounting
SLOW_LEARNING = 0.01  # the same in what kind of robot it is, which does not change

# What the kernels go by.
POLICY = {
    'max_blur': 0.07,  # standard deviation of a block's depth, as a share of it
    'ground_dependence': 10.0,  # blocks of road that tell as much as one: all err one way
    'corridor': 2.5,  # camera heights to either side: beyond, kerbs, lawns and drives lie higher
    # rad: what lies farther off than the camera will have turned by then is on no way.
    'around': 1.0,
    'min_drop': 0.03,  # rad below the horizon: nearer to it a block tells nothing of the height
    'alike': 0.2,  # share of depth by which blocks of one surface below the ground may differ
    'min_depths': 10,  # sharp blocks that tell how far the scene is
    'most': height.MOST,
    'sure': height.SURE,
    # Vehicles beside the camera's way look as far as a road far below: pair after pair the lower
    # edge of one tells a wrong height. What rises shows one depth in all rows, a road does not.
    'above_least': 0.5, 'above_most': 1.5,  # macroblocks from a block up to the one above it
    'beside': 0.75,  # the same aside
    'body_relief': 0.06,  # share of an inverse depth by which a surface is no plane
    'stray': 0.05,  # density of a wrong vector's depth, to the peak of a right one's
    'upright_sure': 3.0,  # times likelier to be upright than level
    'macroblock': float(MACROBLOCK),
}


@dataclass(frozen=True)
class Mount:
    """How the camera sits above the ground: mean of its normal in the camera, and spread [rad].

    The spread is learned: small for a camera bolted to a car, large for one carried by hand, and
    never above ``widest``. ``courses`` have been learned from; the first ones count most.
    ``climb`` is how far they led off the ground for as long as can be remembered [rad].
    """

    direction: tuple[float, float, float] = tuple(UP)
    spread: float = 0.07
    widest: float = 0.07
    courses: int = 0
    climb: float = 0.0

    @property
    def rides(self) -> bool:
        """Tell whether the camera keeps to the ground, so that the plane along it is that.

        Of a flight it may be any plane, with things on both sides of it.
        """
        return self.climb < self.widest

    @property
    def normal(self) -> np.ndarray:
        """Return the mean normal (3,), up."""
        return np.array(self.direction)

    def holds(self, plane: np.ndarray) -> bool:
        """Tell whether a plane (3,) lies as the ground may lie under any mounting."""
        return float(self.normal @ plane) > np.cos(3 * self.widest) * norm(plane)

    def learned(self, course: np.ndarray, least: float) -> 'Mount':
        """Return the mount after one more course, a unit vector (3,) in the camera.

        A vehicle moves along the ground, so the normal is normal to every course; its pitch is
        known from there far better than from the ground itself (0.4 deg of scatter against 2 as
        measured). One that climbs makes the spread grow, and the ground's own tilt counts.
        """
        off = float(self.normal @ course)
        learning = max(LEARNING, 1 / (self.courses + 2))
        mean = self.normal - learning * off * course
        mean /= norm(mean)
        spread = math.sqrt(self.spread**2 + learning * (off**2 - self.spread**2))
        slow = max(SLOW_LEARNING, 1 / (self.courses + 2))
        climb = math.sqrt(self.climb**2 + slow * (off**2 - self.climb**2))
        return Mount(tuple(mean), min(max(spread, least), self.widest), self.widest,
                     self.courses + 1, climb)


@dataclass(frozen=True)
class GroundPrior:
    """What is expected of the ground in camera k."""

    normal: np.ndarray  # (3,): unit normal, up
    tilt: float  # standard deviation of its direction [rad]
    inverse_depth: float = 1.0  # 1 / d [1/baseline]
    spread: float = np.inf  # standard deviation of log(d); infinite: nothing is known
    n_missed: int = 0  # pairs in a row that have not shown it

    def information(self, plane: np.ndarray):
        """Return the prior's mean (3,) and information (3, 3) about a plane (3,)."""
        length, n = norm(plane), self.normal
        radial = 0.0 if np.isinf(self.spread) else 1 / (self.inverse_depth * self.spread) ** 2
        mean = n * (length if np.isinf(self.spread) else self.inverse_depth)
        tangential = 1 / (length * self.tilt) ** 2
        return mean, tangential * (np.eye(3) - np.outer(n, n)) + radial * np.outer(n, n)

    def upright(self, plane: np.ndarray):
        """Return mean (3,) and information (3, 3) of the direction alone of a plane (3,)."""
        return replace(self, spread=np.inf).information(plane)

    def informed(self, belief: HeightBelief) -> 'GroundPrior':
        """Return it with the height that many pairs show, where the last ones knew it less.

        One that contradicts them has to outlast them, unless it is not seen where they were.
        """
        spread = float(np.hypot(belief.spread, height.BIAS))
        if spread > min(self.spread, height.SURE):
            return self
        off = belief.log + np.log(self.inverse_depth)
        contradicts = abs(off) > 3 * np.hypot(self.spread, spread)
        if contradicts and np.isfinite(self.spread) and self.n_missed < MISSED:
            return self
        return replace(self, inverse_depth=float(np.exp(-belief.log)), spread=spread)

    def hold(self, depths: Depths, cut: float) -> np.ndarray:
        """Return which blocks (N,) lie on the ground as far as that is known to."""
        expected = -depths.rays @ self.normal * self.inverse_depth
        sigma = np.hypot(depths.sigma, min(self.spread, height.SURE) * expected)
        return ((np.abs(depths.rho - expected) < cut * sigma)
                & _sharp(depths, self.normal * self.inverse_depth))


@dataclass(frozen=True)
class GroundTrack:
    """The ground from key frame to key frame, in the units of the last pair's baseline.

    ``spread`` is the standard deviation of log(depth); infinite before the ground is found.
    ``tilt`` is that of the normal [rad].
    """

    mount: Mount
    id: int = -1
    plane: np.ndarray | None = None
    spread: float = np.inf
    tilt: float = 0.0
    n_missed: int = 0

    def prior(self, R, t, ratio: float, ratio_sigma: float, wobble: float) -> GroundPrior:
        """Predict the ground through X_cur = R X_prev + t, |t| = 1 = exp(ratio) old baselines."""
        if self.plane is None:
            return GroundPrior(self.mount.normal, self.mount.spread)
        moved = plane_geometry.transform(self.plane * math.exp(ratio), R, t)
        inverse_depth = norm(moved)
        own = math.hypot(wobble, self.tilt)
        expected = moved / inverse_depth / own**2 + self.mount.normal / self.mount.spread**2
        tilt = (1 / own**2 + 1 / self.mount.spread**2) ** -0.5
        # Suspension and slope change the height by a few per cent between key frames.
        spread = math.sqrt(self.spread**2 + ratio_sigma**2 + HEIGHT_WOBBLE**2)
        return GroundPrior(expected / norm(expected), tilt, inverse_depth, spread, self.n_missed)

    def seen(self, id: int, plane: np.ndarray, covariance: np.ndarray) -> 'GroundTrack':
        """Return the track after the ground was found, with its covariance (3, 3)."""
        square = plane @ plane
        # Of a pair that tells next to nothing rounding leaves a variance below zero.
        radial = max(plane @ covariance @ plane, 0) / square
        tilt = np.sqrt(max(covariance.trace() - radial, 0) / 2 / square)
        return GroundTrack(self.mount, id, plane, float(np.sqrt(radial / square)), float(tilt))

    def missed(self, prior: GroundPrior) -> 'GroundTrack':
        """Return the track after it was not; in the end it is looked for afresh."""
        if self.plane is None or prior.spread > FORGOTTEN:
            return GroundTrack(self.mount, self.id)
        return GroundTrack(self.mount, self.id, prior.normal * prior.inverse_depth,
                           np.hypot(prior.spread, 2 * HEIGHT_WOBBLE), prior.tilt,
                           self.n_missed + 1)


@dataclass(frozen=True)
class Ride:
    """How the camera goes, and how far its vectors are believed."""

    course: np.ndarray  # (3,): its way, as of ``course_of``
    turn: float  # how far it turns [rad]
    cut: float  # largest error of a block on the ground [sigma]


def survey(seen: BlockObservations, x: np.ndarray, lone: np.ndarray, prior: GroundPrior,
           belief: HeightBelief, ride: Ride):
    """Learn the height from the blocks before the camera, and tell which lone ones are road.

    All blocks are seen, at pixels x (N, 2); ``lone`` (N,) bool are those whose vectors no
    neighbour supports. ``prior`` and ``belief`` come from the pairs before, in this baseline.
    Returns both with what this pair shows, and which lone blocks (N,) bool lie on the ground; none
    where it is not known.
    """
    depths = Depths(seen.pair.rays_cur, seen.rho, seen.sigma_rho, x)
    way, ahead, drop, ceiling, parallax = compiled.find_way(
        *depths.columns, seen.epipolar_inlier, lone, seen.parallax, prior.normal, ride.course,
        ride.turn, POLICY)
    blocks = RoadBlocks(depths, drop, seen.epipolar_error, seen.pair.sigma, seen.parallax, way)
    belief = belief.seen(blocks, prior.tilt, parallax, ceiling)
    prior = prior.informed(belief)
    road = np.zeros(len(depths), bool)
    if prior.spread < height.SURE:
        at, = (lone & ahead & seen.epipolar_inlier & ~seen.at_infinity).nonzero()
        part = depths[at]
        road[at] = prior.hold(part, ride.cut) & (part.rho > 0)
    return belief, prior, road


def for_movers(seen: np.ndarray | None, prior: GroundPrior, belief: HeightBelief
               ) -> tuple[np.ndarray | None, float]:
    """Return the ground (3,) by which movers are told, and how many times nearer it may be.

    Where none is found the height that many pairs show, if vaguely, tells how far it may lie at
    most: what looks farther than that moves in any case. None where it may lie anywhere.
    """
    if seen is not None:
        return seen, 1.0
    if prior.spread < FORGOTTEN:
        return prior.normal * prior.inverse_depth, 1.0
    spread = float(np.hypot(belief.spread, height.BIAS))
    if spread > GUESSED:
        return None, 1.0
    return (prior.normal * np.exp(-belief.log - FARTHEST * spread),
            float(np.exp(2 * FARTHEST * spread)))


def find_ground(depths: Depths, free: np.ndarray, prior: GroundPrior,
                settings: ExtractionSettings, draws: np.ndarray,
                lone: np.ndarray | None = None) -> PlaneFit | None:
    """Find the ground among stationary blocks; None where too few agree, or too many lie below.

    Level planes through one block and planes through three neighbours are proposed; the one with
    the least truncated squared error is refined. Where the ground is known already it need not be
    found, only seen. What has been pulled to zero, or slid along a marking, lies at all depths:
    below a known ground only blocks that lie alike speak against it. What lies above a ground may
    stand on it; but where most blocks lie elsewhere, chance makes a ground as well.

    Blocks ``free`` (N,) bool are stationary and not at infinity. Beyond three standard deviations
    of the ``prior`` nothing is the ground. ``draws`` (T, 10) are uniform numbers from 0 to 1, by
    which T planes of each kind are drawn. ``lone`` (N,) bool are blocks on a ground that earlier
    pairs have shown, which need no neighbours.
    """
    found = compiled.find_ground(
        *depths.columns, free, np.zeros(len(depths), bool) if lone is None else lone,
        prior.normal, (prior.tilt, prior.inverse_depth, prior.spread), draws,
        {**POLICY, 'cut': settings.epsilon_h, 'radius': settings.radius,
         'min_macroblocks': settings.min_macroblocks})
    return None if found is None else PlaneFit(*found, is_ground=True)


def course_of(t_cur_from_prev: np.ndarray) -> np.ndarray:
    """Return the direction (3,) in the picture in which the camera goes, or comes from.

    Its axis where that is out of the picture: then the road is what it looks at.
    """
    t = t_cur_from_prev
    return t * np.sign(t[2]) if abs(t[2]) > IN_VIEW * norm(t) else np.eye(3)[2]


def _sharp(depths: Depths, plane: np.ndarray) -> np.ndarray:
    """Return the blocks (N,) whose depth on the plane would be known well enough.

    Toward the horizon the ground's parallax vanishes, and what stands on it passes for ground:
    always nearer, never farther, which tilts the plane and with it the camera's height (by 20 %
    in the height for 2 degrees, as measured).
    """
    return depths.sigma < POLICY['max_blur'] * np.maximum(-depths.rays @ plane, 1e-9)
