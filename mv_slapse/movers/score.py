"""How badly a still surface explains each region of blocks that move alike.

Two questions are asked of a region as a whole:

* Does any depth at or above the ground explain it? Its rate g must then be rho t, with rho at
  least the ground's (direction, epipolar and below-ground constraints of [MVO] in one).
* Does it stand where it seems to be? An oncoming car looks like something still and nearer, which
  would hover over the ground that is seen right below it (the magnitude constraint).

The answers are squared distances less what noise gives.
"""

from typing import NamedTuple

from mv_slapse.geometry import lattice
from mv_slapse.geometry.camera import to_rays
from mv_slapse.geometry.moving_plane import RATE, SLOPE
from mv_slapse.movers.moving_plane import Surfaces
from mv_slapse.movers.outlines import Outlines
import numpy as np

BIAS = 0.35  # px that a region's vectors have in common
LEAST_DROP = 8.0  # px below the horizon from which on a lower edge tells something
FOOT_SIGMA = 6.0  # px of the lower edge, seen to a block, and of the horizon
EDGE_SIGMA = lattice.MACROBLOCK / np.sqrt(12)  # px of the lower edge, seen to a block, alone
GROUND_SIGMA = 0.07  # share of the ground's inverse depth: slope, kerbs
BANK_SIGMA = 0.04  # rad by which land slopes beside the road, against the road's plane
LOWEST_PART = 0.3  # height of a part that comes towards the camera, as a share of the camera's
LEAST_FILLED = 0.4  # share of its box that a vehicle's blocks cover
RELIEF = 0.04  # share of a region's rate by which it errs where the region is no plane,
WIDE = 250.0  # px, if it is as wide as this
PULL = 0.04  # share of a turn of the camera by which a region's vectors may all miss it
LEAST_RATIO = 1.2  # of apparent over ground's inverse depth at which something may hover
CLEARANCE = 0.06  # logarithm of that ratio: what is left when the next is taken off
OUTLIER = 0.05  # density of a wrong vector's depth, to the peak of a right one's
UNDERBODY = 0.25  # share of the camera's height above the ground where bodies end: 0.4 m of 1.65
LEAST_REACH = 28.0  # px below a region in which the ground is looked for
HALF_COVERED = 5.0  # px over which blocks below a body cease to show it: 4 of 10 at 4, 1 at 16
SHOWN = 0.15  # share of this place that shows ground that is surely there: fast roads do 0.18
UNSEEN = 8.0  # largest score of what looks below the ground, where that is not seen
NO_LAND = 13.0  # largest score of what looks so, enough for STEP, less what tells of land
DEPENDENCE = 2.0  # blocks below or above a region that tell as much as one
AROUND = 48.0  # px about a region in which copied vectors are counted, or half its size
FEW = 2.0  # blocks there that tell as much as the whole picture
LEAST_COPIED = 0.02  # share of them that there may always be
CREDIT = 0.16  # score of a vector by the odds that it is no copy: kitti00 at 1 Mbit/s has no mover
BORDER = 48.0  # px from the left and right end of the picture: what they cut may be of any width
TOGETHER = 4.0  # departed blocks that tell as much as one: they err by one common depth
STEP = 10.0  # largest part of the score of one pair,
BACK = -5.0  # and smallest


class Seen(NamedTuple):
    """All blocks of a picture.

    Attributes
    ----------
    x : (M, 2) float64
        Centres [px].
    rho, sigma : (M,), (M,) float64
        Apparent inverse depths and what noise makes of them [1/baseline].
    under : (M,) float64
        Inverse depth of the ground there [1/baseline].
    copied : (M,) bool
        Whether nothing still moves like that, but a neighbour does.
    stray : (M,) float64
        Density of a wrong vector's depth, to the peak of a right one's.
    """

    x: np.ndarray
    rho: np.ndarray
    sigma: np.ndarray
    under: np.ndarray
    copied: np.ndarray
    stray: np.ndarray


def scores(fit: Surfaces, outline: Outlines, K: np.ndarray, t: np.ndarray, seen: Seen,
           seen_or_lone: Seen, nearer: float = 1.0) -> np.ndarray:
    """Return squared distances (R,) of regions from all that is still, less what noise gives.

    Parameters
    ----------
    fit, outline : Surfaces, Outlines
        Of R regions.
    K, t : (3, 3), (3,) arrays
        Intrinsics [px]; translation of the camera, the unit of length.
    seen : Seen
        All blocks, in regions or not.
    seen_or_lone : Seen
        The same with those whose vector no neighbour supports.
    nearer : float
        The ground may be this many times nearer; if so nothing is known to hover over it.
    """
    rate, size, drop = fit.theta[:, RATE], outline.size, outline.drop
    W = np.linalg.inv(_covariance(fit, rate, size, K, outline.turned))
    Wt = W @ t
    information = np.maximum(Wt @ t, 1e-12)
    apparent = np.sum(rate * Wt, axis=1) / information
    error = rate - np.maximum(apparent, 0.0)[:, None] * t
    distance = np.sum((W @ error[:, :, None])[:, :, 0] * error, axis=1) - 3
    at_foot, sigma = _at_foot(fit, outline, K, apparent, 1 / np.sqrt(information))
    aside = np.abs(outline.foot[:, 0] - K[0, 2]) * K[1, 1] / K[0, 0]
    share = np.sqrt((FOOT_SIGMA**2 + (BANK_SIGMA * aside)**2) / np.maximum(drop, 1.0)**2
                    + GROUND_SIGMA**2)
    stands = (outline.under > 0) & np.any(t != 0)
    # A hedge along the road is no plane: its foot is nearer than the plane of the whole says.
    # What is larger than a vehicle is a building, and the ground is not where it should be.
    small = _may_be_vehicle(outline)
    farthest = np.maximum(at_foot, outline.rho)
    below = stands * small * _below_ground(farthest, sigma, outline.under, share)
    for i in np.flatnonzero(below > 0):
        seen_there = _ground_below(outline, i, max(farthest[i], 0) / outline.under[i],
                                   seen_or_lone)
        below[i] = min(below[i], max(UNSEEN + seen_there, 0.0))
    distance += np.minimum(below, np.maximum(NO_LAND - outline.land, 0.0))
    at_foot = np.minimum(at_foot, outline.rho)
    # The road's own wrong vectors are short: low or scattered, they are no vehicle.
    road = np.isfinite(drop) & (distance > 0)
    low = road & (size[:, 1] < outline.limit[2] * drop)
    for i in np.flatnonzero(low):
        distance[i] = min(distance[i], max(_body_above(outline, i, seen), 0.0))
    scattered = road & (outline.filled < LEAST_FILLED)
    distance[scattered] = np.minimum(distance[scattered], 0.0)
    for i in np.flatnonzero(stands & (nearer == 1) & _may_hover(outline)
                            & (at_foot >= LEAST_RATIO * outline.under)):
        hovers = _hovers(outline, i, at_foot[i], sigma[i], seen_or_lone)
        # An oncoming car follows the lines of what stands still: that it does tells nothing then.
        distance[i] = hovers + (max(distance[i], 0.0) if hovers > 0 else distance[i])
    # Nothing that a robot could meet ends above the horizon, higher than its camera: what a
    # mover's score came to by mistake is taken back.
    distance[drop < LEAST_DROP] = BACK
    moving = np.flatnonzero(distance > 0)
    distance[moving] = np.minimum(distance[moving], _credible(outline, moving, seen))
    return np.clip(distance, BACK, STEP)


def departures(outline: Outlines, likelihood: np.ndarray, seen: Seen) -> np.ndarray:
    """Return how much rather regions (R,) have left where they stood than not, as chi-square.

    Parameters
    ----------
    outline : Outlines
        Of R regions.
    likelihood : (R,) array
        Sum of the log-likelihoods of their blocks, as of planes.past.departure.
    seen : Seen
        All blocks, in regions or not.
    """
    score = np.minimum(2 * likelihood / TOGETHER,
                       _credible(outline, np.arange(len(likelihood)), seen))
    # Above the horizon nothing is known; nor does a building leave.
    able = _may_be_vehicle(outline) & (outline.drop >= LEAST_DROP)
    return np.where(able, np.clip(score, BACK, STEP), BACK)


def _may_be_vehicle(outline):
    """Return which regions (R,) are no larger than a vehicle."""
    drop = np.maximum(outline.drop, 1.0)
    return np.all(outline.size <= np.outer(drop, outline.limit[:2]), axis=1)


def _credible(outline, at, seen):
    """Return the score that the vectors of some regions deserve, which may all be wrong.

    Short of bits an encoder goes on with the vector beside, over whole shadows. Of such a region
    the vectors repeat each other, and so do wrong ones around it and in the whole picture.
    """
    low, high = outline.low[at, None], outline.high[at, None]
    reach = np.maximum(0.5 * outline.size[at, None], AROUND)
    inside, near = (np.all((seen.x >= low - by) & (seen.x <= high + by), axis=2)
                    for by in (0.0, reach))
    around, share = (near & ~inside).astype(float), np.mean(seen.copied)
    copied = (around @ seen.copied + FEW * share) / (around.sum(axis=1) + FEW)
    copied = np.clip(copied, max(share, LEAST_COPIED), 1.0)
    return CREDIT * outline.kinds[at] * (1 - copied)**2 / copied


def _hovers(outline, i, at_foot, sigma, seen):
    """Return the squared distance of a region from all that stands on the ground."""
    ratio = at_foot / outline.under[i]
    above = max(np.log(_body_end(ratio * outline.drop[i]) / outline.drop[i]), 0.0)
    # Where the ground is seen below it is known: only the edge is not.
    spread = np.sqrt((EDGE_SIGMA / outline.drop[i])**2 + GROUND_SIGMA**2
                     + (sigma / at_foot)**2 + CLEARANCE**2)
    return min((above / spread)**2 - 1, _ground_below(outline, i, ratio, seen))


def _body_end(drop):
    """Return how far below the horizon bodies end that stand ``drop`` [px] below it.

    The ground shows below the body of what is near; of what is far, shadow and wheels hide it.
    """
    return drop - max(UNDERBODY * drop - lattice.MACROBLOCK, 0.0)


def _may_hover(outline):
    """Return which regions (R,) are as high as a vehicle's part or a person may be."""
    height = outline.size[:, 1] / np.maximum(outline.drop, 1.0)
    return (height >= LOWEST_PART) & (height <= outline.limit[1])


def _at_foot(fit, outline, K, apparent, sigma):
    """Return the apparent inverse depth (R,) at the regions' feet and its standard deviation."""
    offset = to_rays(K, outline.foot)[:, :2] - fit.centre
    relative = 1 + np.sum(offset * fit.theta[:, SLOPE], axis=1)
    tilt = fit.covariance[:, SLOPE, SLOPE]
    variance = np.sum((tilt @ offset[:, :, None])[:, :, 0] * offset, axis=1)
    return (apparent * np.clip(relative, 0.5, 2.0),
            np.hypot(sigma, np.abs(apparent) * np.sqrt(np.maximum(variance, 0))))


def _below_ground(at_foot, sigma, under, share):
    """Return the squared distance (R,) of regions from all places at or above the ground."""
    lacking = np.maximum(under - at_foot, 0.0) / np.hypot(sigma, share * under + 1e-12)
    return np.maximum(lacking**2 - 1, 0.0)


def _covariance(fit, rate, size, K, turned):
    """Return the covariance (R, 3, 3) of the rates with what their vectors err alike."""
    shift, growth = BIAS / np.diag(K)[:2], BIAS / (0.5 * np.min(size, axis=1))
    # Vectors show the parallax at the centre and the growth: an error of that goes along the ray.
    ray = np.c_[fit.centre, np.ones(len(rate))] * growth[:, None]
    # A surface that is not one plane shifts its rate by a share of it.
    shape = (RELIEF * np.linalg.norm(rate, axis=1)
             * np.minimum(1.0, np.max(size, axis=1) / WIDE))**2
    covariance = fit.covariance[:, RATE, RATE]
    covariance[:, range(3), range(3)] += shape[:, None]
    covariance[:, range(2), range(2)] += shift**2
    # Where a road has no texture its vectors lag behind a turn, or run ahead of it, all alike.
    lag = PULL * turned / np.diag(K)[:2]
    covariance[:, :2, :2] += lag[:, :, None] * lag[:, None, :]
    return covariance + ray[:, :, None] * ray[:, None, :]


def _body_above(outline, i, seen):
    """Return how much rather a region goes on above than the ground does, as chi-square.

    Of a car ahead only the lower part looks farther than the ground. What is above it shows the
    same depth; above a patch of wrong vectors on the road the road shows its own. A bank beyond a
    ditch shows one depth, too, but it does not end within the picture.
    """
    first, last = np.min(seen.x[:, 0]), np.max(seen.x[:, 0])
    if outline.low[i, 0] < first + BORDER or outline.high[i, 0] > last - BORDER:
        return 0.0
    across = np.abs(seen.x[:, 0] - outline.foot[i, 0]) < 0.5 * outline.size[i, 0]
    above = seen.x[:, 1] < outline.low[i, 1] - lattice.MACROBLOCK / 2
    highest = outline.foot[i, 1] - outline.limit[1] * outline.drop[i]
    at = np.flatnonzero(across & above & (seen.x[:, 1] > highest) & (seen.under > 0))
    under, near = seen.under[at], outline.rho[i]
    sigma = np.hypot(seen.sigma[at], GROUND_SIGMA * np.maximum(under, near))
    ground, region = (np.log(np.exp(-0.5 * ((seen.rho[at] - rho) / sigma)**2) + seen.stray[at])
                      for rho in (under, near))
    return 2 * float(np.sum(region - ground)) / DEPENDENCE


def _ground_below(outline, i, ratio, seen):
    """Return how much rather the ground is seen where a region would hide it, as chi-square.

    A still thing that looks ``ratio`` times nearer than the ground at its foot reaches down to
    where the ground is as near; terrain that looks farther goes on as such. Dark bodywork has no
    vectors; what has some shows either the ground's depth or the region's, and what is nearer than
    both, as a hedge's foot, is no ground. A block that a body in the air covers in part shows it.
    """
    drop = outline.drop[i]
    if not np.isfinite(drop):
        return 0.0
    across = np.abs(seen.x[:, 0] - outline.foot[i, 0]) < 0.5 * outline.size[i, 0]
    below = seen.x[:, 1] - outline.foot[i, 1]
    reach = max((_body_end(ratio * drop) if ratio > 1 else ratio * drop) - drop, LEAST_REACH)
    at = np.flatnonzero(across & (below > 0) & (below < reach))
    under = seen.under[at]
    near = ratio * (outline.under[i] if ratio > 1 else under)
    sigma = np.hypot(seen.sigma[at], GROUND_SIGMA * np.maximum(under, near))
    nearest = np.where((ratio > 1) & (near > under), np.minimum(seen.rho[at], near), seen.rho[at])
    body = np.exp(-0.5 * ((nearest - near) / sigma)**2)
    covered = np.exp(-below[at] / HALF_COVERED) if ratio > 1 else 0.0
    road = np.exp(-0.5 * ((seen.rho[at] - under) / sigma)**2)
    ground, region = np.log(road + covered * body + seen.stray[at]), np.log(body + seen.stray[at])
    # The road must show itself on some of the place.
    shown = np.sum(road > body) * lattice.MACROBLOCK**2 / (outline.size[i, 0] * reach)
    evidence = 2 * np.sum(ground - region) / DEPENDENCE
    return float(evidence * (min(shown / SHOWN, 1.0) if evidence > 0 else 1.0))
