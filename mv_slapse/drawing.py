"""What was found, drawn into a picture: blocks, planes, boxes with id, speed, time to contact."""

from collections.abc import Iterable
from typing import NamedTuple

import cv2
from mv_slapse.geometry.blocks import MACROBLOCK
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
    image = np.repeat(image[..., None], 3, axis=2) if image.ndim == 2 else image
    paint, ids = np.zeros(image.shape, np.float32), np.full(image.shape[:2], -1, np.int32)
    half = MACROBLOCK // 2
    on_plane = np.where(label == Label.STATIONARY, plane, -1)
    for (x, y), value, id_ in zip(centres.round().astype(int), _colours(label, plane), on_plane,
                                  strict=True):
        if value.any():
            block = slice(max(y - half, 0), y + half), slice(max(x - half, 0), x + half)
            paint[block], ids[block] = value, id_
    shown = paint.any(axis=2, keepdims=True) * STRENGTH
    drawn = np.ascontiguousarray((image * (1 - shown) + paint * shown).astype(np.uint8))
    for id_ in np.unique(on_plane[on_plane >= 0]):
        around, _ = cv2.findContours((ids == id_).astype(np.uint8), cv2.RETR_EXTERNAL,
                                     cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(drawn, around, -1, PLANES[id_ % len(PLANES)], 2)
    for box in boxes:
        _draw_box(drawn, box, unit)
    return drawn


def _colours(label: np.ndarray, plane: np.ndarray) -> np.ndarray:
    colours = np.zeros((len(label), 3), np.float32)
    of_plane = (label == Label.STATIONARY) & (plane >= 0)
    colours[of_plane] = np.array(PLANES, np.float32)[plane[of_plane] % len(PLANES)]
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
