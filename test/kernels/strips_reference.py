"""Strips of macroblocks, and whole ones, in numpy, see kernels/strips.cpp."""

import cv2
from mv_slapse.geometry.blocks import MACROBLOCK
import numpy as np
from scipy.ndimage import map_coordinates

HEIGHT, STEPS, NOISE, SHARE, OUTWARDS, SHARP, NEAR = 4, 3, 3.0, 15.0, 1.0, 0.3, 8.0


def patch(picture, left, top, rows):
    """Grey levels of a patch whose first pixel lies between pixels; None outside."""
    height, width = picture.shape
    x, y = int(np.floor(left)), int(np.floor(top))
    if x < 0 or y < 0 or x + MACROBLOCK >= width or y + rows >= height:
        return None
    a, b = left - x, top - y
    part = picture[y:y + rows + 1, x:x + MACROBLOCK + 1].astype(float)
    part = (1 - a) * part[:, :-1] + a * part[:, 1:]
    return (1 - b) * part[:-1] + b * part[1:]


class Search:
    """Least squares matching of a patch; gradients (N, 2) are None where a picture ends."""

    def __init__(self, now, before, left, top, rows):
        self.before, self.left, self.top, self.rows = before, left, top, rows
        self.gradients = None
        height, width = now.shape
        if left < 1 or top < 1 or left + MACROBLOCK >= width or top + rows >= height:
            return
        around = now[top - 1:top + rows + 1, left - 1:left + MACROBLOCK + 1].astype(float)
        self.shown = around[1:-1, 1:-1]
        slopes = around[1:-1, 2:] - around[1:-1, :-2], around[2:, 1:-1] - around[:-2, 1:-1]
        self.gradients = np.stack(
            [slope / 2 - slope.mean() / 2 for slope in slopes], -1).reshape(-1, 2)

    def apart(self, vector):
        """What the patch differs by, less the mean; None where the other picture ends."""
        there = patch(self.before, self.left + vector[0], self.top + vector[1], self.rows)
        if there is None:
            return None
        difference = self.shown - there
        return (difference - difference.mean()).ravel()

    def ends_at(self, start, known):
        """Vector after all steps from one that is known so well."""
        J, vector = self.gradients, np.array(start, float)
        for _ in range(STEPS):
            if self.apart(vector) is None:
                return None
            slope = J.T @ self.apart(vector) / NOISE**2 - known @ (vector - start)
            vector += np.linalg.solve(J.T @ J / NOISE**2 + known, slope)
        return vector


def find(now, before, left, top, known, starts):
    """Vector and variance of a strip; None where it leaves a picture."""
    search = Search(now, before, left, top, HEIGHT)
    if search.gradients is None:
        return None
    misfits = [(np.sum(search.apart(start)**2), k) for k, start in enumerate(starts)
               if search.apart(start) is not None]
    if not misfits:
        return None
    vector = search.ends_at(starts[min(misfits)[1]], known)
    if vector is None or search.apart(vector) is None:
        return None
    noise, J = NOISE**2 + SHARE * np.mean(search.apart(vector)**2), search.gradients
    return vector, 1 / np.linalg.eigvalsh(J.T @ J / noise + known)[0]


def refine(now, before, x_cur, x_prev):
    """Matches (N, 2) of macroblocks as the pictures tell, near those given."""
    out = np.array(x_prev, float)
    for x, match in zip(x_cur, out, strict=True):
        left, top = np.floor(x).astype(int) - 7
        search = Search(now, before, left, top, MACROBLOCK)
        if search.gradients is not None:
            vector = search.ends_at(match - x, np.eye(2) / OUTWARDS**2)
            match[:] = match if vector is None else x + vector
    return out


def beforehand(off, across):
    """Information (2, 2) of where the search begins."""
    away = np.hypot(*off)
    if away < NEAR:
        return np.eye(2) / OUTWARDS**2
    n = off / away
    outer = np.outer(n, n)
    return outer / OUTWARDS**2 + (np.eye(2) - outer) / across**2


def strips(now, before, pair, point, reach, sigma):
    """Columns of a pair with strips, as lists of rows."""
    x_cur, x_prev, spread, probability, block = pair
    columns, rows = (-(-size // MACROBLOCK) for size in now.shape[::-1])
    cell = np.clip(np.floor((x_cur + 0.5) / MACROBLOCK).astype(int), 0, (columns - 1, rows - 1))
    good = probability >= 0.5 * probability.max(initial=0)
    field = {tuple(cell[i]): x_prev[i] - x_cur[i] for i in np.flatnonzero(good)}
    out = []
    for i in range(len(x_cur)):
        off = (x_cur[i] - point).astype(float)
        found = []
        if good[i] and abs(off[0]) < reach and -MACROBLOCK < off[1] < reach:
            column, row = cell[i]
            starts = [x_prev[i] - x_cur[i]] + [
                field[column, other] for other in (row - 1, row + 1) if (column, other) in field]
            for k in range(MACROBLOCK // HEIGHT):
                corner = MACROBLOCK * column, MACROBLOCK * row + HEIGHT * k
                told = find(now, before, *corner, beforehand(off, sigma), starts)
                if told is not None and told[1] < SHARP**2:
                    found.append((np.array(corner) + [7.5, 1.5], *told))
        if len(found) < 2:
            out.append((x_cur[i], x_prev[i], spread[i], probability[i], tuple(block[i])))
            continue
        out += [(x, x + vector, np.sqrt(variance + 4 * sigma**2), probability[i], (16, 4))
                for x, vector, variance in found]
    return [np.array(column) for column in zip(*out, strict=True)]


def picture(rng, width=176, height=112, smooth=2.0):
    """Grey levels with structure of some pixels, in rows that are longer than the picture."""
    grey = cv2.GaussianBlur(rng.normal(0, 1, (height, width + 10)), (0, 0), smooth)
    return np.clip(128 + 40 * grey / grey.std(), 0, 255).astype(np.uint8)[:, :width]


TELLING, TOGETHER = 0.6, 0.5


def earlier_size(off, vector):
    """How large something at `off` from the expansion point was, by the vector to there."""
    return np.clip(1 + off @ vector / max(off @ off, 144), 0.6, 1.3)


def before(x, link, point):
    """Where something at x was, by the nearest vector of a pair."""
    x_cur, x_prev = (column.astype(float) for column in link)
    k = np.argmin((((x_cur - x) / [16, 6])**2).sum(1))
    size = earlier_size(x_cur[k] - point, x_prev[k] - x_cur[k])
    return x_prev[k] + size * (x - x_cur[k])


def sized(picture, x, size):
    """Grey levels (4, 16) of a strip around x that is `size` times as large; None outside."""
    columns = x[0] + size * (np.arange(16) - 7.5)
    rows = x[1] + size * (np.arange(4) - 1.5)
    height, width = picture.shape
    if (min(columns[0], rows[0]) < 0 or np.floor(columns[-1]) + 1 >= width
            or np.floor(rows[-1]) + 1 >= height):
        return None
    return map_coordinates(picture.astype(float), np.meshgrid(rows, columns, indexing='ij'),
                           order=1)


def find_earlier(now, then, left, top, start, point):
    """Centre, place in the earlier picture and sigma along its way; None: not known."""
    x = np.array([left + 7.5, top + 1.5])
    off, search = x - point, Search(now, then, left, top, HEIGHT)
    away = np.hypot(*off)
    if away < NEAR or search.gradients is None:
        return None
    n, size, place = off / away, earlier_size(off, start - x), np.array(start, float)
    J = search.gradients / size
    known = beforehand(off, TOGETHER)
    if NOISE**2 * n @ np.linalg.solve(J.T @ J, n) >= TELLING**2:
        return None
    for last in [False] * (STEPS + 1) + [True]:
        there = sized(then, place, size)
        if there is None:
            return None
        apart = search.shown - there
        apart = (apart - apart.mean()).ravel()
        if not last:
            slope = J.T @ apart / NOISE**2 - known @ (place - start)
            place = place + np.linalg.solve(J.T @ J / NOISE**2 + known, slope)
    variance = (NOISE**2 + SHARE * np.mean(apart**2)) * n @ np.linalg.solve(J.T @ J, n)
    return (x, place, np.hypot(np.sqrt(variance), TOGETHER)) if variance < TELLING**2 else None


def earlier(now, then, links, point, reach):
    """Centres (M, 2), places (M, 2) and sigmas (M,) of strips in an earlier picture."""
    found = []
    for row in range(-(-now.shape[0] // MACROBLOCK)):
        for column in range(-(-now.shape[1] // MACROBLOCK)):
            off = MACROBLOCK * np.array([column, row]) + 7.5 - point
            if not (abs(off[0]) < reach and -MACROBLOCK < off[1] < reach):
                continue
            for top in range(MACROBLOCK * row, MACROBLOCK * (row + 1), HEIGHT):
                start = np.array([MACROBLOCK * column + 7.5, top + 1.5])
                for link in links:
                    start = before(start, link, point)
                found.append(find_earlier(now, then, MACROBLOCK * column, top, start, point))
    return [np.array(column) for column in zip(*filter(None, found), strict=True)]
