"""What was found, drawn into a picture: blocks, planes, boxes with id, speed, time to contact."""

from collections.abc import Iterable
from typing import NamedTuple

import cv2
from mv_slapse.geometry.blocks import grid_shape, MACROBLOCK, macroblock_of
from mv_slapse.records import Label, Obstacle, ObstacleState
import numpy as np

RED, WHITE = (0, 80, 230), (255, 255, 255)  # BGR
FAR = (200, 160, 60)
# Planes next to one another in number are told apart.
PLANES = ((115, 158, 0), (178, 114, 0), (66, 228, 240), (167, 121, 204), (230, 200, 120))
STRENGTH = 0.4


class Box(NamedTuple):
    """An obstacle to draw."""

    id: int
    box: tuple[float, float, float, float]  # x, y of the top left corner, width, height [px]
    speed: float  # [unit/s]
    time_to_contact: float  # [s], infinite where there is none


def box_of(obstacle: Obstacle) -> Box:
    """Return what is drawn of an obstacle."""
    return Box(obstacle.id, tuple(obstacle.box), float(np.linalg.norm(obstacle.velocity)),
               obstacle.time_to_contact)


def is_shown(obstacle: Obstacle) -> bool:
    """Return whether an obstacle is drawn: one that is confirmed."""
    return obstacle.state is ObstacleState.CONFIRMED


def draw(image: np.ndarray, centres: np.ndarray, label: np.ndarray, plane: np.ndarray,
         boxes: Iterable[Box] = (), unit: str = 'm/s') -> np.ndarray:
    """Return a picture with labels and obstacles drawn into it.

    Parameters
    ----------
    image : (H, W) or (H, W, 3) uint8
        Grey or BGR.
    centres : (M, 2)
        Of the macroblocks [px].
    label, plane : (M,)
        Label of each, and the plane or obstacle that it belongs to, -1 for none.
    boxes : iterable of Box
    unit : str
        Of their speed.

    Returns
    -------
    drawn : (H, W, 3) uint8
        BGR; blocks are coloured and outlined by their plane, red where they move.
    """
    image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) if image.ndim == 2 else image
    on_plane = np.where(label == Label.STATIONARY, plane, -1)
    colours = _colours(label, plane)
    paint, shown, ids = (_painted(centres, values, image.shape[1::-1]) for values in (
        colours, colours.any(axis=1).astype(np.uint8), on_plane.astype(np.int32) + 1))
    drawn = image.copy()
    cv2.copyTo(cv2.addWeighted(image, 1 - STRENGTH, paint, STRENGTH, 0), shown, drawn)
    for id_ in np.unique(on_plane[on_plane >= 0]):
        around, _ = cv2.findContours((ids == id_ + 1).astype(np.uint8), cv2.RETR_EXTERNAL,
                                     cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(drawn, around, -1, PLANES[id_ % len(PLANES)], 2)
    for box in boxes:
        _draw_box(drawn, box, unit)
    return drawn


def _painted(centres: np.ndarray, values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """Return a picture of this width and height whose blocks have these values, 0 elsewhere."""
    columns, rows = grid_shape(*size)
    cells = np.zeros((rows, columns, *values.shape[1:]), values.dtype)
    column, row = macroblock_of(centres).T
    cells[row, column] = values
    large = cv2.resize(cells, None, fx=MACROBLOCK, fy=MACROBLOCK, interpolation=cv2.INTER_NEAREST)
    return large[:size[1], :size[0]]


def _colours(label: np.ndarray, plane: np.ndarray) -> np.ndarray:
    colours = np.zeros((len(label), 3), np.uint8)
    of_plane = (label == Label.STATIONARY) & (plane >= 0)
    colours[of_plane] = np.array(PLANES, np.uint8)[plane[of_plane] % len(PLANES)]
    colours[label == Label.INFINITY] = FAR
    colours[label == Label.MOVING] = RED
    return colours


def _draw_box(image: np.ndarray, obstacle: Box, unit: str):
    x, y, w, h = (round(float(value)) for value in obstacle.box)
    text = f'{obstacle.id}: {obstacle.speed:.1f} {unit}'
    if np.isfinite(obstacle.time_to_contact):
        text += f', {obstacle.time_to_contact:.1f} s'
    cv2.rectangle(image, (x, y), (x + w, y + h), RED, 2)
    place = (max(x, 0), max(y - 5, 12))
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 3, cv2.LINE_AA)
    cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.5, WHITE, 1, cv2.LINE_AA)
