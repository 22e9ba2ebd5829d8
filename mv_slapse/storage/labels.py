"""Labels of a key frame on the grid of 16x16 macroblocks."""

from dataclasses import dataclass

from mv_slapse.geometry.blocks import MACROBLOCK, macroblock_of
from mv_slapse.records import Correspondences, Extraction, Label
import numpy as np

N_LABELS = 3


@dataclass(frozen=True)
class LabelGrid:
    """Labels of the macroblocks, row by row.

    Attributes
    ----------
    label : (M,) int8
        As Label; -1 where no vector, or only wrong ones, are.
    plane : (M,) int32
        Plane or obstacle, -1 for none.
    """

    label: np.ndarray
    plane: np.ndarray


def grid_shape(width: int, height: int) -> tuple[int, int]:
    """Return columns and rows of macroblocks; those cut by the border count."""
    return -(-width // MACROBLOCK), -(-height // MACROBLOCK)


def grid_centres(width: int, height: int) -> np.ndarray:
    """Return the centres (M, 2) of the macroblocks [px], row by row."""
    columns, rows = grid_shape(width, height)
    y, x = np.mgrid[:rows, :columns]
    return MACROBLOCK * np.c_[x.ravel(), y.ravel()] + (MACROBLOCK - 1) / 2


def vote(correspondences: Correspondences, extraction: Extraction) -> LabelGrid:
    """Return the label of each macroblock: partitions vote with their area.

    Wrong vectors (UNKNOWN) do not vote; of equal votes the lower label wins. The plane is the
    one with most of the winners' area.
    """
    columns, rows = grid_shape(extraction.width, extraction.height)
    x = _places(correspondences, extraction)
    column, row = macroblock_of(x).T
    inside = (column >= 0) & (column < columns) & (row >= 0) & (row < rows)
    known = inside & (extraction.label != Label.UNKNOWN)
    cell, label = (row * columns + column)[known], extraction.label[known].astype(int)
    plane = extraction.plane_id[known]
    area = extraction.block[known].astype(float).prod(axis=1)
    votes = np.zeros((rows * columns, N_LABELS))
    np.add.at(votes, (cell, label), area)
    winner = np.where(votes.any(axis=1), votes.argmax(axis=1), -1).astype(np.int8)
    won = label == winner[cell]
    return LabelGrid(winner, _majority(cell[won], plane[won], area[won], len(winner)))


def _places(correspondences: Correspondences, extraction: Extraction) -> np.ndarray:
    """Return where the blocks are in the picture: an extraction's pixels are undistorted."""
    same = len(correspondences.x_cur) == len(extraction.x_cur)
    return (correspondences if same else extraction).x_cur


def _majority(cell: np.ndarray, plane: np.ndarray, area: np.ndarray, n: int) -> np.ndarray:
    ids, index = np.unique(plane, return_inverse=True)
    result = np.full(n, -1, np.int32)
    if len(ids):
        votes = np.zeros((n, len(ids)))
        np.add.at(votes, (cell, index.ravel()), area)
        result = np.where(votes.any(axis=1), ids[votes.argmax(axis=1)], -1).astype(np.int32)
    return result
