"""Obstacles of the last key frame against vehicles annotated there (``annotation.json``)."""

from typing import Any, NamedTuple

from mv_slapse.evaluation.detection import boxes, iou, SAME, select, Table
from mv_slapse.storage.tum import Trajectory
import numpy as np


class Vehicle(NamedTuple):
    """An annotated vehicle.

    Attributes
    ----------
    box : (4,) float64
        x, y of the top left corner, width, height [px].
    position, velocity : (2,) float64
        Forward and to the right, relative to the camera [m], [m/s].
    """

    box: np.ndarray
    position: np.ndarray
    velocity: np.ndarray


def vehicles(content: list[dict[str, Any]]) -> list[Vehicle]:
    """Return the vehicles of an annotation, as the TuSimple velocity challenge writes it."""
    found = []
    for item in content:
        left, top, right, bottom = (float(item['bbox'][name])
                                    for name in ('left', 'top', 'right', 'bottom'))
        found.append(Vehicle(np.array([left, top, right - left, bottom - top]),
                             np.array(item['position'], float),
                             np.array(item['velocity'], float)))
    return found


def figures(obstacles: Table, stamp: int, path: Trajectory, annotated: list[Vehicle],
            is_metric: bool) -> dict[str, Any]:
    """Return how many annotated vehicles an obstacle meets, and the largest errors of those.

    Parameters
    ----------
    obstacles : dict
        Columns of obstacles.csv; tentative ones do not count.
    stamp : int
        Of the key frame that shows the annotated picture [ns].
    path : Trajectory
        Of the run; its last two poses tell how fast the camera is.
    annotated : list of Vehicle
    is_metric : bool
        Without, positions and velocities cannot be compared.
    """
    rows = select(obstacles, (obstacles['stamp'] == stamp) & (obstacles['state'] != 'tentative'))
    overlap = iou(boxes(rows), np.array([v.box for v in annotated]).reshape(-1, 4))
    met = [k for k in range(len(annotated)) if overlap[:, k].max(initial=0) >= SAME]
    result = {'annotated_vehicles': len(annotated), 'annotated_vehicles_met': len(met),
              'annotated_position_error_percent': None, 'annotated_velocity_error_m_s': None}
    if not met or not is_metric or len(path) < 2 or path.stamps[-1] != stamp:
        return result
    position, velocity = _relative(rows, path)
    errors = []
    for k in met:
        row, vehicle = overlap[:, k].argmax(), annotated[k]
        errors.append((100 * np.linalg.norm(position[row] - vehicle.position)
                       / np.linalg.norm(vehicle.position),
                       np.linalg.norm(velocity[row] - vehicle.velocity)))
    names = ('annotated_position_error_percent', 'annotated_velocity_error_m_s')
    return result | dict(zip(names, np.max(errors, axis=0).tolist(), strict=True))


def _relative(rows: Table, path: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Return positions and velocities (N, 2), forward and right, relative to the last pose."""
    R, t = path.rotations()[-1], path.positions
    camera = (t[-1] - t[-2]) / (1e-9 * (path.stamps[-1] - path.stamps[-2]))
    position, velocity = (np.c_[tuple(rows[f'{letter}{axis}'] for axis in 'xyz')]
                          for letter in 'pv')
    return ((position - t[-1]) @ R)[:, [2, 0]], ((velocity - camera) @ R)[:, [2, 0]]
