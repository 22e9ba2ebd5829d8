"""Labels of the 16x16 macroblocks of a picture, from those of the blocks that have vectors."""

from mv_slapse.geometry.blocks import grid_index, grid_shape
from mv_slapse.records import Extraction, Label
import numpy as np

N_LABELS = 3


def vote(extraction: Extraction, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return label (M,) int8 and plane (M,) int32 of each macroblock, row by row; -1: none.

    Partitions vote with their area. Wrong vectors (UNKNOWN) do not vote; of equal votes the lower
    label wins. The plane is the one with most of the winners' area.

    Parameters
    ----------
    extraction : Extraction
    x : (N, 2) float32
        Where its blocks are in the picture [px]: an extraction's own pixels are undistorted.
    """
    columns, rows = grid_shape(extraction.width, extraction.height)
    cell = grid_index(x, extraction.width, extraction.height)
    known = (cell >= 0) & (extraction.label != Label.UNKNOWN)
    cell, label = cell[known], extraction.label[known].astype(int)
    plane = extraction.plane_id[known]
    area = extraction.block[known].astype(float).prod(axis=1)
    votes = np.zeros((rows * columns, N_LABELS))
    np.add.at(votes, (cell, label), area)
    winner = np.where(votes.any(axis=1), votes.argmax(axis=1), -1).astype(np.int8)
    won = label == winner[cell]
    return winner, _majority(cell[won], plane[won], area[won], len(winner))


def _majority(cell: np.ndarray, plane: np.ndarray, area: np.ndarray, n: int) -> np.ndarray:
    ids, index = np.unique(plane, return_inverse=True)
    result = np.full(n, -1, np.int32)
    if len(ids):
        votes = np.zeros((n, len(ids)))
        np.add.at(votes, (cell, index.ravel()), area)
        result = np.where(votes.any(axis=1), ids[votes.argmax(axis=1)], -1).astype(np.int32)
    return result
