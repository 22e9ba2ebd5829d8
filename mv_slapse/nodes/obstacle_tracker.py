"""Observed planes, pose and map in; moving obstacles out."""

from dataclasses import dataclass

from mv_slapse import fields
from mv_slapse.config import ObstacleSettings
from mv_slapse.field_values import stamp_from_message
from mv_slapse.nodes import overload
from mv_slapse.nodes.extrinsics import Extrinsics
from mv_slapse.nodes.gate import Gate
from mv_slapse.nodes.handovers import Handovers
from mv_slapse.nodes.obstacle_output import ObstacleOutput
from mv_slapse.nodes.qos import LATCHED, RELIABLE, subscribe
from mv_slapse.nodes.scene_join import continues, SceneJoin, SceneMemory
from mv_slapse.nodes.shell import BACKWARDS, run, Shell
from mv_slapse.obstacles.tracker import ObstacleTracker
from mv_slapse.records import Extraction, Label
from mv_slapse_msgs.msg import PlaneMap, PlaneObservations
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile
from std_msgs.msg import Header

HELD = 100  # key frames kept until the camera's place on the robot is known
#: latched, but every map counts here
MAPS = QoSProfile(depth=RELIABLE.depth, reliability=LATCHED.reliability,
                  durability=LATCHED.durability)


class ObstacleTrackerNode(Shell):
    """ROS side of ObstacleTracker."""

    def __init__(self, **kwargs):
        """Join the topics."""
        super().__init__('obstacle_tracker', **kwargs)
        self._extrinsics, self._output = Extrinsics(self), ObstacleOutput(self)
        self._handovers = Handovers(self, Label.MOVING)
        self._gate = Gate(self._is_ready, self._step, HELD)
        self._join = SceneJoin(self._gate, lambda: self.health.count('observations dropped'))
        self.restart()
        self.keep_draining('obstacles', self._gate)
        self._subscribe(PlaneObservations, 'planes/observations', self._take_observations,
                        'start the plane_extraction node in the same namespace')
        self._subscribe(Odometry, 'odometry', self._take_odometry,
                        'start the slam node in the same namespace; it sends none while lost')
        self._subscribe(PlaneMap, 'planes/map', self._take_map,
                        'start the slam node in the same namespace', MAPS)

    def restart(self):
        """Forget all obstacles."""
        self._tracker, self._newest = ObstacleTracker(self.settings[ObstacleSettings]), 0
        self._memory, self._map_began = SceneMemory(), (0, 0)
        self._handovers.restart()

    def on_settings(self, changed: set[type]):
        """Track anew with new settings of the tracker."""
        if ObstacleSettings in changed:
            self.begin_anew('obstacle settings changed')

    def _subscribe(self, message_type, topic, callback, hint, profile=RELIABLE):
        self.health.watch(topic, hint)
        subscribe(self, message_type, topic, self.guarded(topic, message_type, callback), profile)

    # Each message is checked as it comes: one that waits here could spoil all that follow.
    def _take_observations(self, msg: PlaneObservations):
        extraction = fields.extraction_from_message(msg)
        if self.latency.is_behind():
            extraction = overload.unseen(extraction)
        self._join.add_observations(_Seen(msg.header, extraction))

    def _take_odometry(self, msg: Odometry):
        fields.check_odometry(msg)
        self._join.add_odometry(msg)

    def _take_map(self, msg: PlaneMap):
        fields.check_plane_map(msg)
        self._join.add_map(msg)

    def _is_ready(self, observations: '_Seen', *_) -> bool:
        return self._extrinsics.frames(observations.header.frame_id) is not None

    def _step(self, observations: '_Seen', odometry: Odometry | None, plane_map: PlaneMap):
        extraction = observations.extraction
        if extraction.previous_stamp < self._newest - BACKWARDS:
            self.begin_anew('time went back (a bag played again?)')
        began = plane_map.resets, stamp_from_message(plane_map.began)
        if self._memory.last and began != self._map_began:
            self.begin_anew('slam began anew')
        self._map_began = began
        frames = self._extrinsics.frames(observations.header.frame_id)
        before = self._memory.last
        scene = self._memory.scene(extraction, odometry, plane_map, frames)
        self._report(plane_map, odometry is not None)
        if scene is None:
            return
        if not continues(before, scene):
            self.begin_anew('the odometry jumped (was slam reset?)')
            scene = self._memory.scene(extraction, odometry, plane_map, frames)
        self._newest = max(self._newest, extraction.stamp)
        obstacles, given = self._tracker.step(
            extraction, scene, self._handovers.due(extraction.stamp, frames))
        self._handovers.publish(given, frames)
        self._output.publish(extraction.stamp, obstacles, scene.scale_status, frames)

    def _report(self, plane_map: PlaneMap, has_pose: bool):
        status = fields.tracking_from_message(plane_map).name.lower()
        self.health.set('no_pose', not has_pose, f'slam gives no pose, it is {status}: '
                        f'{plane_map.reason}; see what slam says')
        if has_pose:
            self.health.worked()


@dataclass(frozen=True)
class _Seen:
    header: Header
    extraction: Extraction


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop; return the exit code."""
    return run(ObstacleTrackerNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
