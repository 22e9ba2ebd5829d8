"""The formulas of the kernels of movers in numpy, for comparison."""

from types import SimpleNamespace

import formulas
from mv_slapse.evaluation.detection import grid_index
from mv_slapse.geometry import blocks, two_view
from mv_slapse.geometry.blocks import grid_shape
from mv_slapse.geometry.camera import to_pixels, to_rays
from mv_slapse.movers.moving_plane import homography
import numpy as np
import obstacles_reference
from scipy import ndimage
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from benchmarks.papers import moving_plane
from benchmarks.papers.moving_plane import RATE, SLOPE


def split(members, first):
    """Return the blocks of each region."""
    return np.split(members, first[1:]) if len(first) else []


def per_region(values, first):
    """Return the sum (R,) of values (N,) of each region."""
    return np.add.reduceat(values, first)


def moving_regions(pair, view, ground, nearer, rules):
    """Return what the kernel of that name does."""
    rays, before = to_rays(view.K, pair.x), to_rays(view.K, pair.x_prev)
    focal, n = np.diag(view.K)[:2], len(pair.x)
    m = formulas.parallax(rays, before, focal, view.R)
    under = -(rays @ ground)
    rho, per_pixel = two_view.inverse_depth(rays, before, focal, view.R, view.t)
    error = np.abs(formulas.epipolar_error(rays, before, focal, view.R, view.t)) / pair.sigma
    noise, length = per_pixel * pair.sigma, np.linalg.norm(m, axis=1)
    slack = 3 * noise + rules.on_ground * under
    ground_like = ((under > 0) & (error < 4) & (rho - under > -slack)
                   & (rho - nearer * under < slack) & (pair.departure <= 0))
    far = (under <= 0) & (length < (rules.far if np.any(view.t) else rules.resting))
    nearing = np.maximum(-view.t[2] * np.maximum(rho, 0.0), -rules.receding)
    field = SimpleNamespace(
        m=m, length=length, ground_like=ground_like, far=far,
        below=rho + 2 * noise < rules.below_ground * under, growth=nearing / (1 + nearing))
    a, b = alike(pair, field, np.any(view.t), rules)
    joined, index = ~ground_like[a] & ~ground_like[b], np.flatnonzero(~ground_like & ~far)
    graph = coo_matrix((np.ones(joined.sum()), (a[joined], b[joined])), shape=(n, n))
    part = connected_components(graph, directed=False)[1][index]
    area = pair.block.prod(axis=1) / rules.macroblock**2
    sets = [index[part == k] for k in np.unique(part)]
    sets = [s for s in sets if len(s) >= rules.least and area[s].sum() >= rules.least - 0.5]
    return (m, rho, noise, under, ground_like, far, copied(pair, rules), field.below,
            error < rules.fits,
            np.concatenate([np.zeros(0, int), *sets]),
            np.cumsum([0, *map(len, sets)])[:-1] if sets else np.zeros(0, int))


def copied(pair, rules):
    """Return the blocks (N,) whose vector nothing still explains and a neighbour repeats."""
    wrong, vector = np.flatnonzero(pair.wrong), pair.x_prev - pair.x
    apart = np.abs(pair.x[wrong, None] - pair.x[wrong]).max(axis=2) <= rules.reach
    same = apart & (np.abs(vector[wrong, None] - vector[wrong]).max(axis=2) <= rules.repeated)
    found = np.zeros(len(pair.x), bool)
    found[wrong[same.sum(axis=1) > 1]] = True
    return found


def alike(pair, field, drives, rules):
    """Return the two blocks (P,), (P,) of each pair of neighbours whose vectors are alike."""
    x, m, n = pair.x, field.m, len(pair.x)
    a, b = cKDTree(x).query_pairs(rules.reach, output_type='ndarray').T
    longer = np.maximum(field.length[a], field.length[b])
    slack = np.clip(rules.alike_short * np.median(field.length), 0.5, 1.0) * rules.alike
    by, (growth, more) = x[a] - x[b], (field.growth[at] for at in (a, b))
    share = np.where(np.abs(growth) < np.abs(more), growth, more)
    own = np.clip(np.sum((m[a] - m[b]) * by, axis=1) / np.sum(by**2, axis=1), 0, rules.own_growth)
    apart, left, nearer = (np.linalg.norm(m[a] - m[b] - grown[:, None] * by, axis=1)
                           for grown in (np.zeros(len(a)), share, own))
    same = ((apart < slack + rules.alike_share * longer)
            | (left < slack + rules.alike_grown * longer)
            | (nearer < slack + rules.alike_grown * longer) & (not drives))
    same &= (pair.plane_id[a] == pair.plane_id[b]) & ~field.far[a] & ~field.far[b]
    same &= field.below[a] == field.below[b]
    a, b = a[same], b[same]
    sign = np.sign(pair.departure)
    left = sign + np.bincount(a, sign[b], n) + np.bincount(b, sign[a], n) > 0
    return a[left[a] == left[b]], b[left[a] == left[b]]


def fit_one(x, x_prev, sigma, view, down, rules):
    """Return theta (5,) and covariance (5, 5) of one region, as of fit_moving_surfaces."""
    def rank(values, share):
        return np.sort(values)[int(np.round(share * (len(values) - 1)))]

    def errors(theta):
        at, jacobian = obstacles_reference.transfer(theta, rays, centre, view.K, view.R)
        return (x_prev - at) / sigma[:, None], jacobian / sigma[:, None, None]

    rays = to_rays(view.K, x)
    centre = np.array([0.5 * (rank(v, 0.05) + rank(v, 0.95)) for v in rays[:, :2].T])
    parallax = rays[:, :2] - formulas.derotate(to_rays(view.K, x_prev), view.R)[:, :2]
    theta = np.r_[[rank(v, 0.5) for v in parallax.T], np.zeros(3)]
    rows = np.array([[1 / rules.yaw_sigma, 0],
                     (down[:2] - down[2] * centre) / rules.upright_sigma])
    values = np.array([0.0, -down[2] / rules.upright_sigma])
    for _ in range(int(rules.iterations)):
        error, jacobian = errors(theta)
        squared = np.sum(error**2, axis=1)
        width = max(2 * rules.inlier**2, 4 * rank(squared, 0.5))
        weight = 1 / (1 + squared / width)**2
        normal = np.einsum('n,nai,naj->ij', weight, jacobian, jacobian)
        slope = np.einsum('n,nai,na->i', weight, jacobian, error)
        normal[SLOPE, SLOPE] += rows.T @ rows
        slope[SLOPE] += rows.T @ (values - rows @ theta[SLOPE])
        normal[2, 2] += 1.0
        slope[2] -= theta[2]
        step = np.linalg.solve(normal, slope)
        theta = theta + step
        if step @ slope < rules.converged:
            break
    squared = np.sum(errors(theta)[0]**2, axis=1)
    inlier = squared < 2 * rules.inlier**2
    variance = squared[inlier].sum() / max(2 * inlier.sum() - 5, 1)
    return theta, np.linalg.inv(normal) * max(1.0, variance), centre, inlier, variance


def departures(past, depths, ground, K, stamp, size, rules):
    """Return the log-likelihoods (N,) that blocks have left where they stood."""
    columns, rows = grid_shape(*size)
    X = past.X[(stamp - past.stamp >= rules.youngest) & (past.X[:, 2] > 0)]
    cell = grid_index((X @ K.T)[:, :2] / X[:, 2:], *size)
    grid = np.full(rows * columns, np.inf)
    for k in np.unique(cell[cell >= 0]):
        inside = np.sort(1 / X[cell == k, 2])
        grid[k] = inside[len(inside) // 2]
    grid = grid.reshape(rows, columns)

    def around(values):
        return np.rint(9 * ndimage.uniform_filter(values.astype(float), 3, mode='constant'))

    least = ndimage.minimum_filter(grid, 3)
    least[around(np.isfinite(grid)) < rules.least_seen] = np.nan
    grid[np.isinf(grid)] = np.nan
    at = grid_index(depths.x, *size)
    known = (at >= 0) & (depths.sigma < rules.well_known * depths.rho)
    rho = np.where(known, depths.rho, 1.0)
    sure = rules.farther + rules.sigmas * depths.sigma / rho
    inside, least = (np.log(values.ravel()[at] / rho) for values in (grid, least))
    far = np.where(np.isnan(inside), least, inside)
    left = known & (far > sure) & (far < rules.away)
    left &= rho * np.exp(far) > rules.stood * -(depths.rays @ ground)
    for those, enough in ((least > 0, 1), (True, rules.least_left)):
        held = np.zeros((rows, columns), bool)
        held.ravel()[at[left & those]] = True
        left &= around(held).ravel()[at] >= enough
    stays = np.clip((sure - inside) / (sure - rules.farther), 0.0, 1.0)
    stray = np.where(least > 0, rules.straying, rules.at_edges)
    return (np.where(left, np.log(rules.leaving / stray), 0.0)
            + np.where(known & (inside < sure),
                       stays * np.log((1 - rules.leaving) / (1 - rules.straying)), 0.0))


def votes(extraction, x, n_labels=3):
    """Return label (M,) and plane (M,) of each macroblock, by area."""
    columns, rows = grid_shape(extraction.width, extraction.height)
    cell = grid_index(x, extraction.width, extraction.height)
    area = extraction.block.astype(float).prod(axis=1)
    label, plane = np.full(rows * columns, -1), np.full(rows * columns, -1)
    for k in range(rows * columns):
        own = (cell == k) & (extraction.label >= 0) & (extraction.label < n_labels)
        if np.any(own):
            label[k] = np.bincount(extraction.label[own], area[own]).argmax()
            won = own & (extraction.label == label[k])
            ids = np.unique(extraction.plane_id[won])
            plane[k] = ids[np.argmax([area[won & (extraction.plane_id == i)].sum() for i in ids])]
    return label, plane


def inherited(memory, extraction, lifetime):
    """Return score and id (N,), (N,) that blocks had, nan and -1 where that is unknown."""
    x = memory.x + memory.velocity * ((extraction.previous_stamp - memory.stamp) / 1e9)
    size = np.array([extraction.width, extraction.height])
    kept = ((extraction.previous_stamp - memory.seen < lifetime)
            & np.all((x >= -0.5) & (x < size - 0.5), axis=1))
    grid = blocks.paint(*size, x[kept], memory.block[kept], np.arange(kept.sum()))
    source = blocks.lookup(grid, extraction.x_prev.astype(float))
    return (np.where(source < 0, np.nan, memory.score[kept][source]),
            np.where(source < 0, -1, memory.id[kept][source]))


def grown(pair, regions, moving, products, view, rules):
    """Return the blocks of each moving region with those that move with it."""
    members = split(regions.members, regions.first)
    free, result = ~regions.ground_like, []
    for i in moving:
        free[members[i]] = False
    for i, product in zip(moving, products, strict=True):
        x = pair.x[members[i]]
        low, high = x.min(axis=0) - rules.macroblock, x.max(axis=0) + rules.macroblock
        low[1] -= 0.5 * (high[1] - low[1])
        near = np.flatnonzero(free & np.all((pair.x >= low) & (pair.x <= high), axis=1))
        H = homography(product, view.K, view.R)
        before = to_pixels(H, np.c_[pair.x[near], np.ones(len(near))])
        error = np.linalg.norm(before - pair.x_prev[near], axis=1)
        length = np.linalg.norm(regions.parallax[near], axis=1)
        within = np.all((pair.x[near] >= x.min(axis=0)) & (pair.x[near] <= x.max(axis=0)), axis=1)
        pixel = np.where(within, rules.alike, np.clip(rules.alike_beside * length, 0.5,
                                                      rules.alike))
        slack = np.where(within, rules.inside, 1.0) * (pixel + rules.alike_share * length)
        fits = (error < slack) & (within | ~regions.far[near])
        joins = near[fits | within & pair.wrong[near]]
        free[joins] = False
        result.append(np.r_[members[i], joins])
    return result


def scores(fit, o, K, t, seen, nearer, c):
    """Return the scores (R,) of regions, one after the other."""
    return np.array([_score(i, fit, o, K, t, seen, nearer, c) for i in range(len(o.drop))])


def _score(i, fit, o, K, t, seen, nearer, c):
    theta, own, centre = fit.theta[i], fit.covariance[i], fit.centre[i]
    rate, drop, under = theta[RATE], o.drop[i], o.under[i]
    size = o.high[i] - o.low[i] + c.macroblock
    ray = np.r_[centre, 1] * c.bias / (0.5 * size.min())
    lag = np.r_[c.pull * o.turned[i] / np.diag(K)[:2], 0]
    shape = (c.relief * np.linalg.norm(rate) * min(1, size.max() / c.wide))**2
    W = np.linalg.inv(own[RATE, RATE] + shape * np.eye(3) + np.outer(ray, ray) + np.outer(lag, lag)
                      + np.diag(np.r_[(c.bias / np.diag(K)[:2])**2, 0]))
    information = max(t @ W @ t, 1e-12)
    apparent = rate @ W @ t / information
    error = rate - max(apparent, 0) * t
    distance = error @ W @ error - 3
    off = to_rays(K, o.foot[i:i + 1])[0, :2] - centre
    foot = apparent * np.clip(1 + off @ theta[SLOPE], 0.5, 2)
    sigma = np.hypot(1 / np.sqrt(information),
                     abs(apparent) * np.sqrt(max(off @ own[SLOPE, SLOPE] @ off, 0)))
    height, vehicle = size[1] / max(drop, 1), np.all(size <= max(drop, 1) * o.limit[:2])
    stands = under > 0 and np.any(t)
    if stands and vehicle:
        aside = abs(o.foot[i, 0] - K[0, 2]) * K[1, 1] / K[0, 0]
        share = np.sqrt((c.foot_sigma**2 + (c.bank_sigma * aside)**2) / max(drop, 1)**2
                        + c.ground_sigma**2)
        farthest = max(foot, o.rho[i])
        near = max(farthest, 0)
        below = (max(under - farthest, 0) / np.hypot(sigma, share * under))**2 - 1
        hidden = ground_below(i, near / under, o, seen, c)
        most = min(max(c.no_land - o.land[i], 0), max(c.unseen + hidden, 0))
        rows = looks_farther(i, near, o, seen, c)
        by_rows = max(distance, 0) + min(rows, most) if rows > 0 and most > 0 else -np.inf
        distance = max(distance + max(min(below, most), 0), by_rows)
    foot = min(foot, o.rho[i])
    if np.isfinite(drop) and distance > 0:
        if size[1] < o.limit[2] * drop:
            distance = min(distance, max(body_above(i, o, seen, c), 0))
        if o.filled[i] < c.least_filled:
            distance = min(distance, 0)
    if (stands and nearer == 1 and c.lowest_part <= height <= o.limit[1]
            and foot >= c.least_ratio * under):
        ratio = foot / under
        above = max(np.log(body_end(i, ratio * drop, o, c) / drop), 0)
        spread = np.sqrt((c.edge_sigma / drop)**2 + c.ground_sigma**2 + (sigma / foot)**2
                         + c.clearance**2)
        hovers = min((above / spread)**2 - 1, ground_below(i, ratio, o, seen, c))
        distance = hovers + (max(distance, 0) if hovers > 0 else distance)
    if drop < c.least_drop:
        distance = c.back
    if distance > 0:
        distance = min(distance, credible(i, o, seen, c))
    return np.clip(distance, c.back, c.step)


def credible(i, o, seen, c):
    """Return the score that the vectors of a region deserve, which may all be copied."""
    reach = np.maximum(0.5 * (o.high[i] - o.low[i] + c.macroblock), c.around)
    inside, near = (np.all((seen.x >= o.low[i] - by) & (seen.x <= o.high[i] + by), axis=1)
                    for by in (0.0, reach))
    share = np.mean(seen.copied)
    copied = ((seen.copied[near & ~inside].sum() + c.few * share)
              / ((near & ~inside).sum() + c.few))
    copied = np.clip(copied, max(share, c.least_copied), 1)
    return c.credit * o.kinds[i] * (1 - copied)**2 / copied


def body_end(i, drop, o, c):
    """Return how far below the horizon a body ends that stands so far below it."""
    height = o.high[i, 1] - o.low[i, 1] + c.macroblock
    return drop - max(c.underbody * height - c.macroblock, 0)


def across(i, o, seen, c):
    """Return which blocks are in the columns of a region."""
    width = o.high[i, 0] - o.low[i, 0] + c.macroblock
    return np.abs(seen.x[:, 0] - o.foot[i, 0]) < 0.5 * width


def body_above(i, o, seen, c):
    """Return how much rather a region goes on above than the ground does."""
    first, last = seen.x[:, 0].min(), seen.x[:, 0].max()
    if o.low[i, 0] < first + c.border or o.high[i, 0] > last - c.border:
        return 0.0
    at = (across(i, o, seen, c) & (seen.x[:, 1] < o.low[i, 1] - c.macroblock / 2)
          & (seen.x[:, 1] > o.foot[i, 1] - o.limit[1] * o.drop[i]) & (seen.under > 0))
    under, rho = seen.under[at], seen.rho[at]
    sigma = np.hypot(seen.noise[at], c.ground_sigma * np.maximum(under, o.rho[i]))
    ground, region = (np.log(np.exp(-0.5 * ((rho - as_if) / sigma)**2) + c.outlier)
                      for as_if in (under, o.rho[i]))
    return 2 * np.sum(region - ground) / c.dependence


def looks_farther(i, near, o, seen, c):
    """Return how much rather a region is farther than the ground, which shows beside it."""
    left, right = (o.low[i, 0] - c.macroblock / 2, o.high[i, 0] + c.macroblock / 2)

    def told(near, low, high):
        at = ((seen.x[:, 0] > low) & (seen.x[:, 0] < high) & (seen.under > near)
              & (seen.x[:, 1] < o.foot[i, 1]))
        under, rho = seen.under[at], seen.rho[at]
        sigma = np.hypot(seen.noise[at], c.ground_sigma * under)
        farther, ground = (np.exp(-0.5 * (np.maximum(off, 0) / sigma)**2) + c.outlier
                           for off in (rho - near, under - rho))
        return 2 * np.sum(np.log(farther) - np.log(ground)) / c.dependence
    low = max(near, 0.5 * o.under[i])
    sides = max(told(low, left - c.around, left), told(low, right, right + c.around))
    return min(told(near, left, right), max(c.unseen - sides, 0))


def ground_below(i, ratio, o, seen, c):
    """Return how much rather the ground is seen where a region would hide it."""
    drop, below = o.drop[i], seen.x[:, 1] - o.foot[i, 1]
    if not np.isfinite(drop):
        return 0.0
    end = body_end(i, ratio * drop, o, c) if ratio > 1 else ratio * drop
    reach = max(end - drop, c.least_reach)
    at = across(i, o, seen, c) & (below > 0) & (below < reach)
    under, rho = seen.under[at], seen.rho[at]
    near = ratio * (o.under[i] if ratio > 1 else under)
    sigma = np.hypot(seen.noise[at], c.ground_sigma * np.maximum(under, near))
    nearest = np.where((ratio > 1) & (near > under), np.minimum(rho, near), rho)
    body = np.exp(-0.5 * ((nearest - near) / sigma)**2)
    covered = np.exp(-below[at] / c.half_covered) if ratio > 1 else 0.0
    road = np.exp(-0.5 * ((rho - under) / sigma)**2)
    evidence = np.sum(np.log(road + covered * body + c.outlier) - np.log(body + c.outlier))
    if ratio < 1 and np.any(at):
        land = np.clip(np.median(rho / under), ratio, 1) * under
        lower = np.exp(-0.5 * ((rho - land) / sigma)**2)
        evidence -= max(np.sum(np.log(lower + c.outlier) - np.log(road + c.outlier))
                        + np.log(c.outlier), 0)
    evidence *= 2 / c.dependence
    width = o.high[i, 0] - o.low[i, 0] + c.macroblock
    shown = np.sum(road > body) * c.macroblock**2 / (width * reach)
    return evidence * (min(shown / c.shown, 1) if evidence > 0 else 1)


def settled(fit, alike, i, view, ground, rules):
    """Return what the kernel settle_surface does."""
    rows = alike.rows(i)
    at, inlier, theta, centre = alike.members[rows], fit.inlier[rows], fit.theta[i], fit.centre[i]
    if inlier.sum() < max(rules.least, 0.5 * len(at)) or not np.all(np.isfinite(theta)):
        return None
    gauge, found = np.zeros(6), None
    if ground is not None:
        foot = moving_plane.contact(alike.x[at][inlier], alike.block[at][inlier])
        found = moving_plane.contact_depth(ground, foot, view.K, theta[SLOPE], centre)
    if found is None:
        free = (rules.nearest, rules.farthest)
        nearest = theta[RATE] @ view.t / max(theta[RATE] @ theta[RATE], 1e-12)
        log_depth = np.log(np.clip(nearest, *free)) if np.any(view.t) else np.mean(np.log(free))
        variance = rules.free_sigma**2
    else:
        gauge[SLOPE], log_depth, variance = found.by_slope, found.value, found.variance
    by_theta = np.vstack([np.eye(5, 6), gauge])
    covariance = by_theta @ np.pad(fit.covariance[i], (0, 1)) @ by_theta.T
    covariance[5, 5] += variance
    state, jacobian = moving_plane.to_plane(np.r_[theta, log_depth], centre, view.t)
    return (state[:3], jacobian @ covariance @ jacobian.T, state[3:],
            moving_plane.product(theta, centre), found is not None)
