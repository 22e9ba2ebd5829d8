"""Observations, odometry and map of one stamp, joined again into a scene; free of ROS."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from mv_slapse.fields import scene_from_messages, stamp_from_message, tracking_from_message
from mv_slapse.obstacles import units
from mv_slapse.records import Extraction, SceneEstimate, WITH_POSE
from mv_slapse.ros_frames import RosFrames
import numpy as np

BOUND = 100  # messages kept on each topic

Complete = Callable[[Any, Any, Any], None]


class SceneJoin:
    """Calls ``complete(observations, odometry, plane_map)`` in order of the observations' stamps.

    ``odometry`` is None where the map says that there is no pose. Where the map of a stamp was
    lost on the way (it is latched, so only the newest is kept for late readers) the one before
    stands in; where the odometry was lost the observations are dropped.
    """

    def __init__(self, complete: Complete, dropped: Callable[[], None] = lambda: None):
        """Begin empty; ``dropped`` is called for each observation that finds no partner."""
        self._complete, self._dropped = complete, dropped
        self.restart()

    def restart(self):
        """Forget all messages."""
        self._observations: dict[int, Any] = {}
        self._odometry: dict[int, Any] = {}
        self._maps: dict[int, Any] = {}

    def add_observations(self, msg: Any):
        """Take observations."""
        self._add(self._observations, msg)

    def add_odometry(self, msg: Any):
        """Take a pose."""
        self._add(self._odometry, msg)

    def add_map(self, msg: Any):
        """Take a map."""
        self._add(self._maps, msg)

    def _add(self, messages: dict[int, Any], msg: Any):
        messages[stamp_from_message(msg.header.stamp)] = msg
        while len(messages) > BOUND:
            messages.pop(min(messages))
        while self._observations and self._join(min(self._observations)):
            pass

    def _join(self, stamp: int) -> bool:
        """Complete or drop the observations of ``stamp``; return whether that was possible."""
        odometry, plane_map = self._odometry.get(stamp), self._maps.get(stamp)
        if plane_map is None and odometry is not None and self._is_overdue(stamp):
            earlier = [at for at in self._maps if at < stamp]
            plane_map = self._maps[max(earlier)] if earlier else None
        has_pose = plane_map is not None and tracking_from_message(plane_map) in WITH_POSE
        if plane_map is not None and (odometry is not None or not has_pose):
            self._complete(self._observations.pop(stamp), odometry, plane_map)
        elif self._is_overdue(stamp):
            self._observations.pop(stamp)
            self._dropped()
        else:
            return False
        self._forget(stamp)
        return True

    def _is_overdue(self, stamp: int) -> bool:
        """Return whether both topics have gone on to later stamps, or one far beyond."""
        later = [sum(at > stamp for at in messages) for messages in (self._odometry, self._maps)]
        return min(later) > 0 or max(later) > 5

    def _forget(self, stamp: int):
        """Drop what is done with; the newest map stays, to stand in for a lost one."""
        for at in [at for at in self._odometry if at <= stamp]:
            del self._odometry[at]
        for at in sorted(at for at in self._maps if at <= stamp)[:-1]:
            del self._maps[at]


class SceneMemory:
    """Scenes from messages, with what the messages do not say taken from the scene before."""

    def __init__(self):
        """Know no scene yet."""
        self.last: SceneEstimate | None = None

    def scene(self, extraction: Extraction, odometry: Any, plane_map: Any,
              frames: RosFrames) -> SceneEstimate | None:
        """Return the scene of a key frame; without a pose the last one, None before the first."""
        if odometry is None:
            status = tracking_from_message(plane_map)
            return self.last and replace(self.last, stamp=extraction.stamp, status=status,
                                          reason=plane_map.reason, baseline=0.0)
        scene = scene_from_messages(odometry, plane_map, frames)
        self.last = replace(scene, baseline=self._baseline(scene, extraction.previous_stamp))
        return self.last

    def _baseline(self, scene: SceneEstimate, previous_stamp: int) -> float:
        """Return the distance to the pose before, by the velocity where that is not known."""
        last = self.last and _in_unit_of(self.last, scene)
        if last is not None and last.stamp == previous_stamp:
            return float(np.linalg.norm(scene.t_world_from_cam - last.t_world_from_cam))
        dt = (scene.stamp - previous_stamp) / 1e9
        return float(np.linalg.norm(scene.velocity_world) * dt)


def continues(before: SceneEstimate | None, scene: SceneEstimate) -> bool:
    """Return whether a pose follows from the one before; it does not where slam began anew."""
    if before is None:
        return True
    before = _in_unit_of(before, scene)
    if before is None:
        return False
    dt = (scene.stamp - before.stamp) / 1e9
    speed = np.linalg.norm(before.velocity_world) + np.linalg.norm(scene.velocity_world)
    variance = sum(np.trace(s.pose_covariance[:3, :3]) for s in (before, scene))
    moved = np.linalg.norm(scene.t_world_from_cam - before.t_world_from_cam)
    return bool(moved <= 3 * speed * dt + 5 * np.sqrt(variance))


def _in_unit_of(before: SceneEstimate, now: SceneEstimate) -> SceneEstimate | None:
    """Return the scene that was published last in the unit of the one now; None: another map."""
    unit = units.last_unit(before, now)
    return None if unit is None else units.scene_in_unit(before, unit, before.t_world_from_cam)
