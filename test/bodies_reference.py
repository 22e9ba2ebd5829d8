"""The formulas of the kernel of bodies in numpy, for comparison."""

from mv_slapse.geometry.blocks import MACROBLOCK
import numpy as np
from scipy.ndimage import map_coordinates


def grid_of(view, ground, size, before, c):
    """Return inverse depths (D,) [1/baseline] and what pairs before told of them (D, C)."""
    norm, inverse = np.linalg.norm(ground), np.linalg.inv(view.K)
    n = int(np.ceil(size[0] / MACROBLOCK))
    lowest = max(-ground @ inverse @ [0.5 * size[0], size[1], 1], 1e-3 * norm)
    depths = lowest * np.geomspace(c.farthest, c.nearest, int(c.depths))
    told = np.zeros((len(depths), n))
    if before.told.shape != told.shape or view.t[2] >= 0:
        return depths, told
    x = MACROBLOCK * np.arange(n) + 7.5
    rays = inverse @ np.stack([x, np.full(n, view.K[1, 2]), np.ones(n)])
    points = np.moveaxis(rays[:, None] / depths[:, None], 0, -1) - view.t
    pixels = points @ (view.K @ view.R.T).T
    rows = np.log(1 / (pixels[..., 2] * norm) / before.depths[0])
    rows = rows / np.log(before.depths[1] / before.depths[0])
    columns = (pixels[..., 0] / pixels[..., 2] - 7.5) / MACROBLOCK
    told = c.fading * map_coordinates(before.told, [rows, columns], order=1)
    course = view.K[0, 2] + view.K[0, 0] * view.t[0] / view.t[2]
    aside = np.abs(x - course) / view.K[0, 0] * norm / depths[:, None]
    return depths, np.where(aside <= c.lane, told, 0)


def bodies(field, depths, before, c):
    """Return blocks and lasting evidence of each body, and what lasts of all depths (D, C).

    As of with_bodies where there is no region yet, from the grid of the pairs before.
    """
    at = np.flatnonzero(field.fits & (field.under > 0))
    x, y, under = *field.x[at].T, field.under[at]
    lower = 1 - field.rho[at] / under
    sharp = (field.noise[at] < c.sharp * under) & (lower > 0) & (lower < 1)
    uneven = max(c.road, np.median(np.r_[lower[sharp], [0.6745 * c.road] * int(c.usual)]) / 0.6745)
    last, highest = np.argmax(under), np.argmin(under)
    slope = (under[last] - under[highest]) / max(y[last] - y[highest], 1)
    n = before.shape[1]
    column = np.clip((x / MACROBLOCK).astype(int), 0, n - 1)
    columns = [at[column == k][np.argsort(y[column == k], kind='stable')] for k in range(n)]
    now, foot = np.zeros_like(before), np.zeros_like(before)
    for d, k in np.ndindex(before.shape):
        now[d, k], _, end = told_of(field, columns[k], depths[d], uneven, c)
        foot[d, k] = field.under[columns[k][end - 1]] / slope if end else 0
    told = np.maximum(before + np.minimum(now, c.once), 0)
    lasting = np.maximum(before + np.minimum(now, c.lasting), 0)
    found = []
    while len(found) < c.many and (best := surest(told, foot, c)):
        d, own = best
        depth = depths[d]
        for _ in range(2):
            body, depth = body_at(field, [columns[k] for k in own], depth, uneven, c)
        for k in own:
            columns[k], told[:, k] = np.zeros(0, int), 0
        found.append((np.sort(body), np.sum(lasting[d, own] - c.beside)))
    return [(body, evidence) for body, evidence in found if len(body) >= c.blocks], lasting


def surest(told, foot, c):
    """Return depth and columns of the body that is told most of; None where none is enough."""
    best, where = c.least, None
    for d in range(len(told)):
        for first in range(told.shape[1]):
            total = lowest = 0.0
            for k in range(first, told.shape[1]):
                total += told[d, k] - c.beside
                lowest = max(lowest, foot[d, k])
                if total <= 0 or (k + 1 - first) * MACROBLOCK > c.widest * lowest:
                    break
                if total > best:
                    best, where = total, (d, np.arange(first, k + 1))
    return where


def body_at(field, columns, depth, uneven, c):
    """Return the blocks of a body in some columns, and the depth that they show."""
    rows = [told_of(field, column, depth, uneven, c) for column in columns]
    body = np.concatenate([column[a:b] for column, (_, a, b) in zip(columns, rows, strict=True)])
    variance = field.noise[body]**2 + (c.body * depth)**2
    keep = (((field.rho[body] - depth)**2 <= c.agrees**2 * variance)
            & (field.under[body] >= c.above * depth))
    body, weight = body[keep], 1 / variance[keep]
    return body, np.sum(weight * field.rho[body]) / np.sum(weight) if len(body) else depth


def told_of(field, column, depth, uneven, c):
    """Return what a column tells of a body at a depth, and the blocks [first, end) of that."""
    if not len(column):
        return 0.0, 0, 0
    under, rho, variance = field.under[column], field.rho[column], field.noise[column]**2
    ground, body = ((rho - as_if)**2 / (variance + (share * as_if)**2)
                    for as_if, share in ((under, uneven), (depth, c.body)))
    gain = 0.5 * (np.minimum(ground, 2 * c.most) - np.minimum(body, 2 * c.most))
    crossing = int(np.argmax(np.r_[under > depth, True]))

    below, upward = gain[crossing:], gain[:crossing][::-1]
    if first_two(upward, c) < -c.beside:
        return first_two(upward, c), crossing, crossing
    # Where even the first block shows the ground, that counts against the body.
    down, rows = reached(below, 1, c)
    return down, crossing - reached(upward, 0, c)[1], crossing + rows


def reached(gains, least, c):
    """Return the greatest sum of the first gains, of so many at least, and of how many."""
    best, length, total = 0.0, 0, 0.0
    for k, one in enumerate(gains):
        if total <= best - c.most:
            break
        total += one
        if k < least or total > best:
            best, length = total, k + 1
    return best, length


def first_two(upward, c):
    """Return what the first two blocks above tell, the second only where the first may be."""
    return np.sum(upward[:2]) if len(upward) < 2 or upward[0] > -c.most else upward[0]
