"""The formulas of the kernel of bodies in numpy, for comparison."""

from mv_slapse.geometry.blocks import MACROBLOCK
import numpy as np


def bodies(field, width, c):
    """Return the blocks of each body, as of with_bodies where there is no region yet."""
    at = np.flatnonzero(field.fits & (field.under > 0))
    x, y, under = *field.x[at].T, field.under[at]
    lower = 1 - field.rho[at] / under
    sharp = (field.noise[at] < c.sharp * under) & (lower > 0) & (lower < 1)
    uneven = max(c.road, np.median(np.r_[lower[sharp], [0.6745 * c.road] * int(c.usual)]) / 0.6745)
    last, highest = np.argmax(under), np.argmin(under)
    slope = (under[last] - under[highest]) / max(y[last] - y[highest], 1)
    n = int(np.ceil(width / MACROBLOCK))
    column = np.clip((x / MACROBLOCK).astype(int), 0, n - 1)
    columns = [at[column == k][np.argsort(y[column == k], kind='stable')] for k in range(n)]
    depths = under.max() * np.geomspace(c.farthest, c.nearest, int(c.depths))
    told = {(d, k): told_of(field, columns[k], d, uneven, c) for d in depths for k in range(n)}
    found = []
    while len(found) < c.many and (best := surest(field, columns, depths, told, slope, c)):
        depth, own = best
        for _ in range(2):
            body, depth = body_at(field, [columns[k] for k in own], depth, uneven, c)
        for k in own:
            _, a, b = told_of(field, columns[k], depth, uneven, c)
            left = np.delete(columns[k], slice(a, b))
            columns[k] = left[~np.isin(left, body)]
            for d in depths:
                told[d, k] = told_of(field, columns[k], d, uneven, c) if b > a else (0.0, 0, 0)
        found.append(np.sort(body))
    return [body for body in found if len(body) >= c.blocks]


def surest(field, columns, depths, told, slope, c):
    """Return depth and columns of the body that is told most of; None where none is enough."""
    best, where = c.least, None
    for d in depths:
        for first in range(len(columns)):
            total = foot = 0.0
            for k in range(first, len(columns)):
                own, _, end = told[d, k]
                total += own - c.beside
                foot = max(foot, field.under[columns[k][end - 1]] / slope if own > 0 else 0)
                if total <= 0 or (k + 1 - first) * MACROBLOCK > c.widest * foot:
                    break
                if total > best:
                    best, where = total, (d, range(first, k + 1))
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
    under = field.under[column]
    gain = np.zeros(len(column))
    for rho, sigma in ((field.rho, field.noise), tuple(field.foreseen.T)):
        variance = sigma[column]**2
        ground, body = ((rho[column] - as_if)**2 / (variance + (share * as_if)**2)
                        for as_if, share in ((under, uneven), (depth, c.body)))
        gain += 0.5 * (np.minimum(ground, 2 * c.most) - np.minimum(body, 2 * c.most))
    crossing = int(np.argmax(np.r_[under > depth, True]))

    def reached(gains):
        best, total, length = 0.0, 0.0, 0
        for k, one in enumerate(gains):
            if total <= best - c.most:
                break
            total += one
            if total > best:
                best, length = total, k + 1
        return best, length
    down, rows = reached(gain[crossing:])
    upward = gain[:crossing][::-1]
    if first_two(upward, c) < -c.beside:
        return 0.0, crossing, crossing
    return down, crossing - reached(upward)[1], crossing + rows


def first_two(upward, c):
    """Return what the first two blocks above tell, the second only where the first may be."""
    return np.sum(upward[:2]) if len(upward) < 2 or upward[0] > -c.most else upward[0]
