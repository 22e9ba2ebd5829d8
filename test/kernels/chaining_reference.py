"""Chaining in numpy: the formulas that the kernels are compared with."""

from dataclasses import replace

from mv_slapse.codec.chaining import SAMPLE
from mv_slapse.config import DecoderSettings
from mv_slapse.geometry import rotation
from mv_slapse.geometry.blocks import MACROBLOCK, macroblock_of
from mv_slapse.geometry.camera import Camera, to_rays, undistort
from mv_slapse.records import Correspondences, SegmentKind
import numpy as np

# Share of the blocks with less parallax than is told. Traffic ahead keeps its distance, so that
# up to three fifths of the picture show none however far the camera moves.
FARTHER = 0.7
ROUNDS = 4  # of reweighting
AROUND = np.array([[row, column] for row in (-1, 0, 1) for column in (-1, 0, 1)])
ABSENT = np.float32(1e6)  # px, place and vector where there is none
STEADY = 0.3  # share of a vector by which the one before may differ: what comes near speeds up


def chain(newer: Correspondences, older: Correspondences,
          settings: DecoderSettings) -> Correspondences:
    """Chain two pairs as ``mv_slapse.codec.chaining.chain`` does, in numpy."""
    lone = newer.lone
    motion, variance, known = _sample(older.supported(), newer.x_prev, settings)
    if lone.any():
        motion[lone], variance[lone], known[lone] = _sample(older, newer.x_prev[lone], settings)
        vector = (newer.x_prev - newer.x_cur)[lone]
        limit = settings.agreement_slack + STEADY * np.hypot(*vector.T)
        known[lone] &= np.hypot(*(motion[lone] - vector).T) < limit
        known &= np.any(known & ~lone)  # or none would be lone any more
    x_cur, x_prev = newer.x_cur[known], newer.x_prev[known] + motion[known]
    sigma = np.sqrt(newer.sigma[known] ** 2 + variance[known])
    return replace(newer, previous_stamp=older.previous_stamp, kind=SegmentKind.CHAINED,
                   n_b=newer.n_b + older.n_b, x_cur=x_cur, x_prev=x_prev, sigma=sigma,
                   probability=newer.probability[known] * older.probability.mean(
                       dtype=np.float32) if len(older) else newer.probability[known],
                   block=newer.block[known])


def _sample(pair: Correspondences, x: np.ndarray, settings: DecoderSettings):
    """Return motion, variance and presence of a pair's vectors at arbitrary pixels (N, 2)."""
    table = _table(pair)
    column, row = np.clip(macroblock_of(x) + 1, 1, np.subtract(table.shape[::-1], 2)).T
    near = table[row[:, None] + AROUND[:, 0], column[:, None] + AROUND[:, 1]]
    vector, place = (np.r_[part, np.full((1, 2), ABSENT)][near]
                     for part in (pair.x_prev - pair.x_cur, pair.x_cur))
    weight = np.maximum(1 - np.abs(place - x[:, None]) / MACROBLOCK, 0).prod(axis=2)
    weight *= _of_one_surface(vector, weight.argmax(axis=1), settings)
    whole = weight.sum(axis=1)
    known = whole > 0.25
    weight /= np.maximum(whole, 1e-6)[:, None]
    sigma = np.r_[pair.sigma, np.float32(0)][near]
    variance = (weight * sigma ** 2).sum(axis=1)
    return (weight[:, None] @ vector)[:, 0], variance, known


def _of_one_surface(vector: np.ndarray, lead: np.ndarray, settings: DecoderSettings) -> np.ndarray:
    """Return which vectors (N, 9, 2) around go on from the leading one (N,): (N, 9) bool.

    Those that are much like it, and two on opposite sides of the middle one that agree with it
    in the mean: on a road vectors grow from row to row by more than vectors may differ. Without
    the rows beside, all of a row would be continued from the same side.
    """
    middle, leading = vector[:, [4]], vector[np.arange(len(lead)), lead][:, None]
    limit = (settings.agreement_slack
             + settings.agreement_tolerance * np.hypot(*np.moveaxis(leading, 2, 0)))
    gaps = vector - leading, 0.5 * (vector + vector[:, ::-1]) - middle
    return np.minimum(*(np.hypot(*np.moveaxis(gap, 2, 0)) for gap in gaps)) < limit


def _table(pair: Correspondences) -> np.ndarray:
    """Return the row of the correspondence in each macroblock, with a border; len(pair): none."""
    shape = -(-pair.height // MACROBLOCK) + 2, -(-pair.width // MACROBLOCK) + 2
    table = np.full(shape, len(pair))
    column, row = macroblock_of(pair.x_cur).T + 1
    table[row, column] = np.arange(len(pair))
    return table


def parallax(pair: Correspondences, camera: Camera | None) -> float:
    """Return the length [px] of what a rotation of the camera leaves of the motion.

    Three tenths of the blocks show more. The rotation is fitted to the motion itself, robustly,
    so part of a translation may pass for one: never too much parallax is told. Without a camera,
    shift and turn of the picture stand for the rotation.
    """
    if len(pair) < 8:
        return 0.0
    some = slice(None, None, max(len(pair) // SAMPLE, 1))
    x_cur, x_prev = pair.x_cur[some].astype(float), pair.x_prev[some].astype(float)
    left = _without_shift(x_cur, x_prev) if camera is None else _without_rotation(
        to_rays(camera.K, undistort(camera, x_cur)), to_rays(camera.K, undistort(camera, x_prev)),
        camera.K[0, 0])
    return float(np.quantile(np.hypot(*left.T), FARTHER))


def _without_rotation(cur: np.ndarray, prev: np.ndarray, focal: float) -> np.ndarray:
    """Return the motion [px] of rays (N, 3) after the rotation that explains most of it."""
    weight, design = np.ones(len(cur)), _turn_of_camera(cur[:, :2])
    for _ in range(ROUNDS):
        prev = prev @ rotation.exp(_fit(design, _gap(cur, prev), weight)).T
        weight = _trust(focal * _gap(cur, prev))
    return focal * _gap(cur, prev)


def _without_shift(cur: np.ndarray, prev: np.ndarray) -> np.ndarray:
    """Return the motion [px] of pixels (N, 2) after the shift and turn that explain most."""
    weight, motion = np.ones(len(cur)), prev - cur
    design = _turn_of_picture((cur - cur.mean(axis=0)) / MACROBLOCK)
    for _ in range(ROUNDS):
        left = motion - design @ _fit(design, motion, weight)
        weight = _trust(left)
    return left


def _gap(cur: np.ndarray, prev: np.ndarray) -> np.ndarray:
    return prev[:, :2] / prev[:, 2:] - cur[:, :2]


def _trust(left: np.ndarray) -> np.ndarray:
    """Return Cauchy weights of residuals [px]."""
    return 1 / (1 + np.hypot(*left.T) ** 2)


def _fit(design: np.ndarray, motion: np.ndarray, weight: np.ndarray) -> np.ndarray:
    normal = np.einsum('nij,n,nik->jk', design, weight, design)
    return np.linalg.solve(normal, np.einsum('nij,n,ni->j', design, weight, motion))


def _turn_of_camera(x: np.ndarray) -> np.ndarray:
    """Return d motion / d rotation (N, 2, 3) of normalised pixels (N, 2)."""
    x, y = x.T
    return np.moveaxis(np.array([[x * y, -(1 + x * x), y], [1 + y * y, -x * y, -x]]), 2, 0)


def _turn_of_picture(x: np.ndarray) -> np.ndarray:
    """Return d motion / d (shift, turn) (N, 2, 3) of pixels about their centre (N, 2)."""
    one, (x, y) = np.ones(len(x)), x.T
    return np.moveaxis(np.array([[one, 0 * one, -y], [0 * one, one, x]]), 2, 0)
