"""The map's unit of length: from some key frame on it is the metre; what is kept must follow."""

from dataclasses import replace

from mv_slapse.records import PlaneHandover, ScaleStatus, SceneEstimate
import numpy as np

LEAST = 1e-6  # [map unit] of lengths that tell a unit


def last_unit(before: SceneEstimate, now: SceneEstimate) -> float | None:
    """Return how long the unit of the scene before is in the one of the scene now.

    By the ground's depth, that of other planes that both maps hold or, without any, the speed,
    which hardly changes from one key frame to the next. Before a camera that has only stood no map
    has a unit. None where nothing tells, and where a map that was metric is no more: that is
    another one.
    """
    if before.scale_status is now.scale_status:
        return 1.0
    if now.scale_status is not ScaleStatus.METRIC:
        return None
    old = {plane.id: _depth(plane, before) for plane in before.planes}
    shared = [plane for plane in now.planes if plane.id in old]
    shared = [plane for plane in shared if plane.is_ground] or shared
    if shared:
        new, was = np.sum([(_depth(plane, now), old[plane.id]) for plane in shared], axis=0)
    else:
        new, was = (np.linalg.norm(scene.velocity_world) for scene in (now, before))
        if was <= LEAST and not before.planes:
            return 1.0
    return float(new / was) if min(new, was) > LEAST else None


def _depth(plane, scene):
    """Return how far a plane is from the camera; from {W} its tilt would weigh more and more."""
    return abs(plane.depth + plane.normal @ scene.t_world_from_cam)


def in_unit_of(before: SceneEstimate, now: SceneEstimate) -> SceneEstimate | None:
    """Return the scene before in the unit of the one now; None where that is not known."""
    unit = last_unit(before, now)
    return None if unit is None else scene_in_unit(before, unit)


def scene_in_unit(scene: SceneEstimate, unit: float) -> SceneEstimate:
    """Return pose, velocity and baseline of a scene in a unit that makes ``unit`` of its own."""
    return replace(scene, t_world_from_cam=unit * scene.t_world_from_cam,
                   velocity_world=unit * scene.velocity_world, baseline=unit * scene.baseline)


def handover_in_unit(item: PlaneHandover, unit: float) -> PlaneHandover:
    """Return a hand-over in a unit that makes ``unit`` of its own."""
    scale = np.repeat([1 / unit, unit], 3)
    return replace(item, plane=item.plane / unit, velocity=unit * item.velocity,
                   covariance=item.covariance * np.outer(scale, scale))
