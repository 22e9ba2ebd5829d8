"""The formulas of kernels/surfaces.cpp in numpy: windows, what planes explain, the choice."""

from dataclasses import dataclass

from mv_slapse.surfaces.plane_search import POLICY
import numpy as np
from scipy import ndimage

LEAST, CAP, REACH = POLICY['least'], POLICY['cap'], POLICY['reach']


@dataclass
class Blocks:
    """Whitened blocks: a @ plane + c is an error; windows as rows of means."""

    a: np.ndarray
    c: np.ndarray
    x: np.ndarray
    up: np.ndarray
    min_macroblocks: int

    def __post_init__(self):
        """Lay windows, fit planes to them, and let each block be judged by the best."""
        cell = np.floor((self.x + 0.5) / 16).astype(int)
        self.cell = cell - cell.min(axis=0)
        self.windows, self.planes, squared = [], [], []
        for shape, is_tall in (((5, 5), False), ((3, 9), True)):
            step = np.array(shape) // 2
            for j in range(0, self.cell[:, 1].max() + 1, step[1]):
                for i in range(0, self.cell[:, 0].max() + 1, step[0]):
                    off = self.cell - (i, j)
                    which = np.flatnonzero(np.all((off >= 0) & (off < shape), axis=1))
                    if len(which) < LEAST:
                        continue
                    plane = self.window_plane(which, is_tall)
                    self.windows.append(which)
                    self.planes.append(plane)
                    if len(which) >= 1.5 * LEAST and not is_tall:
                        squared.append(np.square(self.a[which] @ plane + self.c[which]))
        self.noise = 1.0
        if squared:
            median = np.median(np.concatenate(squared))
            self.noise = np.clip(np.sqrt(median / 0.455 / 0.87), 1.0, 4.0)
        self.a, self.c = self.a / self.noise, self.c / self.noise
        self.cost = np.array([np.mean(np.minimum(self.squared(plane)[which], CAP))
                              for which, plane in zip(self.windows, self.planes, strict=True)])
        least = np.full(len(self.c), np.inf)
        self.best = np.full(len(self.c), -1)
        for w, which in enumerate(self.windows):
            better = which[self.cost[w] + 3 / len(which) < least[which]]
            least[better], self.best[better] = self.cost[w] + 3 / len(which), w

    def squared(self, plane):
        return np.square(self.a @ plane + self.c)

    def window_plane(self, which, is_tall):
        a, c, weight = self.a[which], self.c[which], 1.0
        for _ in range(3):
            A = a.T @ (weight * a if np.isscalar(weight) else weight[:, None] * a)
            A += (10 * np.finfo(float).eps * np.trace(A) + 1e-12) * np.eye(3)
            b = -a.T @ (weight * c)
            plane = np.linalg.solve(A, b)
            weight = 1 / np.square(1 + np.square(a @ plane + c) / CAP)
        if is_tall:
            B = np.linalg.svd(self.up[None])[2][1:].T
            plane = B @ np.linalg.solve(B.T @ A @ B, B.T @ b)
        return plane

    def gain(self, plane):
        """Return how well a plane explains each block."""
        squared = self.squared(plane)
        worse = np.array([np.mean(np.minimum(squared[which], CAP)) for which in self.windows])
        gain = np.maximum(POLICY['max_excess'] - (worse - self.cost)[self.best], 0)
        return np.where((squared < POLICY['cut']**2) & (self.best >= 0), gain, 0)

    def upright(self, plane, covariance):
        toward = covariance @ self.up
        variance = toward @ self.up + POLICY['lean']**2 * plane @ plane / POLICY['dependence']
        off = plane @ self.up
        if off**2 >= POLICY['upright_gate'] * POLICY['dependence'] * variance:
            return plane, covariance
        return (plane - toward * off / variance,
                covariance - np.outer(toward, toward) / variance)

    def fit(self, part, plane):
        a, c = self.a[part], self.c[part]
        for _ in range(2):
            weight = 1 / np.square(1 + np.square(a @ plane + c) / 4)
            A = a.T @ (weight[:, None] * a)
            A += (1e-9 * np.trace(A) + 1e-12) * np.eye(3)
            plane = np.linalg.solve(A, -a.T @ (weight * c))
        plane, covariance = self.upright(plane, np.linalg.inv(A))
        return plane, POLICY['dependence'] * covariance

    def grown(self, w):
        plane, centre = self.planes[w], self.x[self.windows[w]].mean(axis=0)
        near = np.all(np.abs(self.x - centre) < REACH, axis=1)
        for width in (2.0, 1.0, 1.0):
            weight = near / np.square(1 + self.squared(plane) / width**2)
            A = self.a.T @ (weight[:, None] * self.a)
            A += (10 * np.finfo(float).eps * np.trace(A) + 1e-12) * np.eye(3)
            covariance = np.linalg.inv(A)
            plane = self.upright(covariance @ (-self.a.T @ (weight * self.c)), covariance)[0]
        return plane, near

    def together(self, mask):
        """Return the largest connected part of a mask, empty where it is too small."""
        if mask.sum() < LEAST:
            return np.zeros_like(mask)
        grid = np.zeros(self.cell.max(axis=0)[::-1] + 3, bool)
        at = self.cell[:, 1] + 1, self.cell[:, 0] + 1
        grid[at[0][mask], at[1][mask]] = True
        number = ndimage.label(ndimage.binary_dilation(grid, np.ones((3, 3))), np.ones((3, 3)))[0]
        number = np.where(mask, number[at], 0)
        part = number == 1 + np.argmax(np.bincount(number)[1:])
        return part if part.sum() >= LEAST else np.zeros_like(mask)

    def density(self, part):
        own = np.zeros(self.cell.max(axis=0) + 5, bool)
        own[tuple(self.cell[part].T + 2)] = True
        inside = ndimage.binary_closing(own, np.ones((3, 3)))[tuple(self.cell.T + 2)]
        return np.mean(part[inside]) if inside.any() else 0.0

    def is_plane(self, part, plane, covariance, before):
        least = self.min_macroblocks * (POLICY['fading'] if before >= 0 else 1)
        return (len(np.unique(self.cell[part], axis=0)) >= least
                and np.sqrt(np.trace(covariance)) < POLICY['vague'] * np.linalg.norm(plane)
                and self.density(part) >= POLICY['density'])


def distance(a, b):
    off = b[0] - a[0]
    return off @ np.linalg.solve(a[1] + b[1], off)


def fused(a, b):
    gain = a[1] @ np.linalg.inv(a[1] + b[1])
    rest = (np.eye(3) - gain) @ a[1]
    return a[0] + gain @ (b[0] - a[0]), 0.5 * (rest + rest.T)


def seen_again(blocks, known, least):
    """Return [plane, covariance, before] of known planes found, and what they take."""
    found, taken = [], np.zeros(len(blocks.c))
    for before, track in enumerate(known):
        gain = blocks.gain(track[0])
        for _ in range(2):
            part = blocks.together(gain > taken)
            fitted = blocks.fit(part, track[0]) if part.any() else None
            if fitted is None or distance(known[before], fitted) >= POLICY['same_gate']:
                part[:] = False
                break
            track = fused(known[before], fitted)
            gain = blocks.gain(track[0])
        part &= gain > taken
        if np.sum((gain - taken)[part]) >= 0.5 * least:
            found.append([*track, before])
            taken = np.where(part, gain, taken)
    return found, taken


def find_new(blocks, taken, room, least):
    """Return [plane, covariance, -1] of new planes."""
    found, proposed, explained = [], [], taken
    asked = {w: np.flatnonzero(blocks.best == w) for w in set(blocks.best[blocks.best >= 0])}
    enough = POLICY['judged'] - 1
    for w in sorted((w for w in asked if len(asked[w]) > enough), key=lambda w: asked[w][enough]):
        if np.mean(explained[blocks.windows[w]] == 0) > 0.5:
            plane, near = blocks.grown(w)
            proposed.append((plane, np.where(near, blocks.gain(plane), 0)))
            explained = np.maximum(explained, proposed[-1][1])
    for _ in range(2 * room):
        more = [np.maximum(gain - taken, 0).sum() for _, gain in proposed]
        if not more or max(more) < least or len(found) == room:
            break
        plane, gain = proposed.pop(int(np.argmax(more)))
        for _ in range(2):
            part = blocks.together(gain > taken)
            if not part.any():
                break
            plane, covariance = blocks.fit(part, plane)
            gain = blocks.gain(plane)
        part = blocks.together(gain > taken)
        if np.sum((gain - taken)[part]) >= least:
            found.append([plane, covariance, -1])
            taken = np.where(part, np.maximum(gain, taken), taken)
    return found


def find_planes(rays, rho, sigma, x, known, up, room, min_macroblocks):
    """Return (before, plane, covariance, own plane, its covariance, member) of each plane."""
    sigma = np.hypot(sigma, POLICY['roughness'] * rho) + 1e-9
    index = np.flatnonzero(sigma < POLICY['max_blur'] * rho)
    order = np.lexsort((np.floor((x[index, 1] + 0.5) / 16), np.floor((x[index, 0] + 0.5) / 16)))
    index = index[order]
    scale = sigma[index]
    blocks = Blocks(rays[index] / scale[:, None], rho[index] / scale, x[index], up,
                    min_macroblocks)
    least = 1.4 * POLICY['max_excess'] * min_macroblocks
    found, taken = seen_again(blocks, known, least)
    found += find_new(blocks, taken, room - len(found), least)
    for _ in range(2 if found else 0):
        gains = np.stack([blocks.gain(track[0]) for track in found], axis=1)
        owner = np.where(gains.max(axis=1) > 0, gains.argmax(axis=1), -1)
        parts = [blocks.together(owner == i) for i in range(len(found))]
        for track, part in zip(found, parts, strict=True):
            if part.any():
                fitted = blocks.fit(part, track[0])
                track[:2] = fitted if track[2] < 0 else fused(known[track[2]], fitted)
    result = []
    for (plane, covariance, before), part in zip(found, parts if found else [], strict=True):
        if blocks.is_plane(part, plane, covariance, before):
            member = np.zeros(len(rho), bool)
            member[index[part]] = True
            result.append((before, plane, covariance, *blocks.fit(part, plane), member))
    return result
