"""The formulas of kernels/ground.cpp in numpy: the height's belief, the choice of the ground."""

from mv_slapse.surfaces import height
from mv_slapse.surfaces.ground import POLICY
from mv_slapse.surfaces.height import GRID
import numpy as np
from scipy import ndimage


def off_plane(depths, plane):
    """Return the distance (N,) of depths from a plane, in standard deviations."""
    return (depths.rho + depths.rays @ plane) / depths.sigma


def distance(prior, planes):
    """Return the squared Mahalanobis distance (N,) of planes (N, 3); those facing down are far."""
    length = np.linalg.norm(planes, axis=1)
    angle = np.arccos(np.clip(planes @ prior.normal / length, -1, 1))
    return (np.square(angle / prior.tilt)
            + np.square(np.log(length / prior.inverse_depth) / prior.spread))


def moved(probability, log_ratio, width):
    """Return a belief moved by a log ratio and spread by a width."""
    after = np.interp(GRID + log_ratio, GRID, probability, 0.0, 0.0)
    reach = np.arange(-np.ceil(3 * width / height.STEP), np.ceil(3 * width / height.STEP) + 1)
    kernel = np.exp(-0.5 * np.square(reach * height.STEP / width))
    after = np.convolve(after, kernel / kernel.sum())[len(reach) // 2:][:len(GRID)]
    return (1 - height.LEAK) * after + (1 - (1 - height.LEAK) * after.sum()) / len(GRID)


def seen(probability, blocks, tilt, least, ceiling):
    """Return a belief after blocks of a road, right ones and wrong ones."""
    is_ = height.POLICY
    depths, gate = blocks.depths, is_['gate']
    use = blocks.on_way & (blocks.parallax > least)
    right = use & (np.abs(blocks.error) < gate) & (depths.rho > 0)
    wrong = use & (np.abs(blocks.error) > gate)
    length = blocks.parallax[wrong]
    chance = np.arcsin(np.minimum(gate * blocks.sigma[wrong] / length, 1.0)) / np.pi
    passing = chance / (1 - 2 * np.minimum(chance, 0.4))
    gap = np.log(blocks.parallax[right])[:, None] - np.log(length)
    near = np.exp(-0.5 * np.square(gap / is_['isotropy'])) / (np.sqrt(2 * np.pi) * is_['isotropy'])
    stray = (near @ passing + 1 / 6) / (passing.sum() + 1)
    share = np.clip(1 - passing.sum() / right.sum(), is_['right_least'], is_['right_most'])
    expected = blocks.drop[right][:, None] * np.exp(-GRID)
    rough = np.hypot(is_['relief'], tilt / blocks.drop[right])[:, None]
    sigma = np.hypot(depths.sigma[right][:, None], rough * expected)
    error = (depths.rho[right][:, None] - expected) / sigma
    density = np.exp(-0.5 * np.square(error)) * expected / (np.sqrt(2 * np.pi) * sigma)
    gain = np.log(1 - share + share * density / stray[:, None])
    gain[sigma > is_['blurred'] * expected] = 0
    x = depths.x[right]
    around = np.sum(np.all(np.abs(x[:, None] - x) < is_['apart'], axis=2), axis=1)
    every = 1 + len(x) // is_['asked']
    log = every / (is_['sites'] * around[::every]) @ gain[::every] + np.log(probability)
    log = np.where(np.log(ceiling) > GRID, log, -np.inf)
    after = np.exp(log - log.max())
    return after / after.sum()


def proposals(depths, normal, radius, draws):
    """Return planes (T, 3), level ones first."""
    one = (draws[:, 0] * len(depths)).astype(int)
    level = normal * (depths.rho / -(depths.rays @ normal))[one][:, None]
    tilted, order = [], np.argsort(depths.x[:, 0], kind='stable')
    columns = depths.x[order, 0]
    for draw in draws:
        first = int(draw[1] * len(depths))
        low = np.searchsorted(columns, depths.x[first, 0] - radius)
        high = np.searchsorted(columns, depths.x[first, 0] + radius, 'right')
        others = order[low + (draw[2:] * (high - low)).astype(int)]
        far = np.abs(depths.x[others, 1] - depths.x[first, 1]) > radius
        triple = np.r_[first, others[np.argsort(far, kind='stable')[:2]]]
        M = depths.rays[triple]
        if np.abs(np.linalg.det(M)) > 1e-6:
            tilted.append(-np.linalg.solve(M, depths.rho[triple]))
    return np.vstack([level, *tilted])


def refined(depths, plane, mean, information):
    for _ in range(5):
        weight = 1 / np.square(1 + np.square(off_plane(depths, plane) / 2)) / depths.sigma**2
        A = depths.rays.T @ (weight[:, None] * depths.rays) + information
        b = -depths.rays.T @ (weight * depths.rho) + information @ mean
        A += np.eye(3) * (1e-9 * np.trace(A) + 1e-12)
        plane = np.linalg.solve(A, b)
    return plane, np.linalg.inv(A)


def large(x, smallest):
    """Return the mask of pixels in components of enough macroblocks."""
    cell = np.floor((x + 0.5) / 16).astype(int)
    cell -= cell.min(axis=0)
    grid = np.zeros(cell.max(axis=0) + 3, bool)
    grid[tuple(cell.T + 1)] = True
    number = ndimage.label(ndimage.binary_dilation(grid, np.ones((3, 3))), np.ones((3, 3)))[0]
    sizes = np.bincount(number[grid], minlength=number.max() + 1)
    return sizes[number[tuple(cell.T + 1)]] >= smallest


def find_ground(depths, free, prior, rules, draws, lone):
    """Return plane, covariance and member, or None; counts of macroblocks are not checked."""
    across = np.cross(prior.normal, [0, 0, 1.0])
    drop = -depths.rays @ prior.normal
    ahead = (drop > POLICY['min_drop']) & (
        np.abs(depths.rays @ (across / np.linalg.norm(across))) < POLICY['corridor'] * drop)
    use = free & ahead & (depths.rho > 0)
    sample, known = depths[use], prior.spread < height.SURE

    def sharp(d, plane):
        return d.sigma < POLICY['max_blur'] * np.maximum(-d.rays @ plane, 1e-9)

    planes = proposals(sample, prior.normal, 4 * rules.radius, draws)
    off = distance(prior, planes)
    planes, off = planes[off < 9], off[off < 9]
    if not len(planes):
        return None
    expected = -planes @ sample.rays.T
    error = np.square((sample.rho - expected) / sample.sigma)
    error[sample.sigma > POLICY['max_blur'] * expected] = np.inf
    cost = np.minimum(error, rules.epsilon_h**2).sum(axis=1) / rules.epsilon_h**2 + off
    plane = planes[np.argmin(cost)]
    for _ in range(2):
        mean, information = prior.information(plane)
        plane, covariance = refined(sample[sharp(sample, plane)], plane, mean,
                                    POLICY['ground_dependence'] * information)
    member = use & sharp(depths, plane) & (np.abs(off_plane(depths, plane)) < rules.epsilon_h)
    index = np.flatnonzero(member)
    member[index] = lone[index] | large(depths.x[index], rules.min_macroblocks // 4)
    off = off_plane(sample, plane)
    below = sample[off < -rules.epsilon_h]
    log = np.sort(np.log(below.rho / -(below.rays @ plane)))
    alike = np.max(np.searchsorted(log, log + POLICY['alike']) - np.arange(len(log)), initial=0)
    speaks = alike if known else np.sum(np.abs(off) > rules.epsilon_h)
    if speaks > member.sum() or distance(prior, plane[None])[0] > 9:
        return None
    return plane, covariance, member
