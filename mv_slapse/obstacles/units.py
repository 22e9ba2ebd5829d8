"""The map's unit of length: where it changes, as when it becomes the metre, all that is kept must.

All lengths change about the position that was published last, which stays: X' = place +
unit (X - place) in {W}.
"""

from mv_slapse.changed import replace
from mv_slapse.obstacles.view import plane_moved
from mv_slapse.records import PlaneHandover, ScaleStatus, SceneEstimate
import numpy as np


def last_unit(before: SceneEstimate, now: SceneEstimate) -> float | None:
    """Return how long the unit of the scene before is in the one of the scene now.

    None where a map that was metric is no more: that is another one.
    """
    if before.scale_status is ScaleStatus.METRIC and now.scale_status is not ScaleStatus.METRIC:
        return None
    return now.unit / before.unit


def scene_in_unit(scene: SceneEstimate, unit: float, place: np.ndarray) -> SceneEstimate:
    """Return pose, velocity and baseline of a scene in a unit that makes ``unit`` of its own.

    ``place`` (3,) in {W} stays.
    """
    return replace(scene, t_world_from_cam=place + unit * (scene.t_world_from_cam - place),
                   velocity_world=unit * scene.velocity_world, baseline=unit * scene.baseline,
                   unit=unit * scene.unit)


def handover_in_unit(item: PlaneHandover, unit: float, place: np.ndarray) -> PlaneHandover:
    """Return a hand-over in a unit that makes ``unit`` of its own; ``place`` (3,) in {W} stays."""
    plane, by_plane = plane_moved(item.plane / unit, np.eye(3), (1 - unit) * place)
    J = unit * np.eye(6)
    J[:3, :3] = by_plane / unit
    return replace(item, plane=plane, velocity=unit * item.velocity,
                   covariance=J @ item.covariance @ J.T)
