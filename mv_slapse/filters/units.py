"""The map's unit of length: from some key frame on it is the metre; what is kept must follow."""

from dataclasses import replace

from mv_slapse.records import PlaneHandover, ScaleStatus, SceneEstimate
import numpy as np

LEAST = 1e-6  # [map unit] of lengths that tell a unit


def has_changed(before: SceneEstimate, now: SceneEstimate) -> bool:
    """Return whether a map began to be metric, or another one began, between two key frames."""
    return before.scale_status is not now.scale_status


def last_unit(before: SceneEstimate, now: SceneEstimate) -> float | None:
    """Return how long the unit of the scene before is in the one of the scene now.

    By the planes that both maps hold or, without any, the speed, which hardly changes from one
    key frame to the next. None where neither tells, and where a map that was metric is no more:
    that is another one.
    """
    if not has_changed(before, now):
        return 1.0
    if now.scale_status is not ScaleStatus.METRIC:
        return None
    old = {plane.id: plane.depth for plane in before.planes}
    planes = [(abs(p.depth), abs(old[p.id])) for p in now.planes if p.id in old]
    speeds = [np.linalg.norm(scene.velocity_world) for scene in (now, before)]
    new, was = np.sum(planes, axis=0) if planes else speeds
    return float(new / was) if min(new, was) > LEAST else None


def scene_in_unit(scene: SceneEstimate, unit: float) -> SceneEstimate:
    """Return pose, velocity and baseline of a scene in a unit that makes ``unit`` of its own."""
    return replace(scene, t_world_from_cam=unit * scene.t_world_from_cam,
                   velocity_world=unit * scene.velocity_world, baseline=unit * scene.baseline)


def handover_in_unit(item: PlaneHandover, unit: float) -> PlaneHandover:
    """Return a hand-over in a unit that makes ``unit`` of its own."""
    scale = np.repeat([1 / unit, unit], 3)
    return replace(item, plane=item.plane / unit, velocity=unit * item.velocity,
                   covariance=item.covariance * np.outer(scale, scale))
