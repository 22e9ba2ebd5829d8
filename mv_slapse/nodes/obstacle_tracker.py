"""Observed planes, pose and map in; moving obstacles out."""

from mv_slapse import fields
from mv_slapse.config import ObstacleSettings
from mv_slapse.nodes.extrinsics import Extrinsics
from mv_slapse.nodes.gate import Gate
from mv_slapse.nodes.handovers import Handovers
from mv_slapse.nodes.health import every
from mv_slapse.nodes.obstacle_output import ObstacleOutput
from mv_slapse.nodes.qos import LATCHED, RELIABLE, subscribe
from mv_slapse.nodes.scene_join import continues, SceneJoin, SceneMemory
from mv_slapse.nodes.shell import run, Shell
from mv_slapse.obstacles.tracker import ObstacleTracker
from mv_slapse.records import Label
from mv_slapse_msgs.msg import PlaneMap, PlaneObservations
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile

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
        every(self, 0.1, lambda: self.attempt('obstacles', self._gate.drain))
        self._subscribe(PlaneObservations, 'planes/observations', self._join.add_observations,
                        'start the plane_extraction node in the same namespace')
        self._subscribe(Odometry, 'odometry', self._join.add_odometry,
                        'start the slam node in the same namespace; it sends none while lost')
        self._subscribe(PlaneMap, 'planes/map', self._join.add_map,
                        'start the slam node in the same namespace', MAPS)

    def restart(self):
        """Forget all obstacles."""
        self._tracker, self._newest = ObstacleTracker(self.settings[ObstacleSettings]), 0
        self._memory = SceneMemory()
        self._handovers.restart()

    def _subscribe(self, message_type, topic, callback, hint, profile=RELIABLE):
        self.health.watch(topic, hint)
        subscribe(self, message_type, topic, self.guarded(topic, callback), profile)

    def _is_ready(self, observations: PlaneObservations, *_) -> bool:
        return self._extrinsics.frames(observations.header.frame_id) is not None

    def _step(self, observations: PlaneObservations, odometry: Odometry | None,
              plane_map: PlaneMap):
        extraction = fields.extraction_from_message(observations)
        if extraction.stamp < self._newest:
            self._begin_anew('time went back (a bag played again?)')
        frames = self._extrinsics.frames(observations.header.frame_id)
        before = self._memory.last
        scene = self._memory.scene(extraction, odometry, plane_map, frames)
        if scene is None:
            return
        if not continues(before, scene):
            self._begin_anew('the odometry jumped (was slam reset?)')
            scene = self._memory.scene(extraction, odometry, plane_map, frames)
        self._newest = extraction.stamp
        obstacles, given = self._tracker.step(
            extraction, scene, self._handovers.due(self._newest, frames))
        self._handovers.publish(given, frames)
        self._output.publish(extraction.stamp, obstacles, scene.scale_status, frames)

    def _begin_anew(self, reason: str):
        self.get_logger().warning(f'{reason}: starting anew')
        self.restart()


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop; return the exit code."""
    return run(ObstacleTrackerNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
