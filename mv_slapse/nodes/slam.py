"""Observed planes in; pose, twist, transform and plane map out."""

from mv_slapse import fields
from mv_slapse.config import SceneSettings
from mv_slapse.nodes import overload
from mv_slapse.nodes.archive import Archive
from mv_slapse.nodes.extrinsics import Extrinsics
from mv_slapse.nodes.gate import Gate
from mv_slapse.nodes.handovers import Handovers
from mv_slapse.nodes.known_place import KnownPlace
from mv_slapse.nodes.placement import Placement
from mv_slapse.nodes.qos import RELIABLE, subscribe
from mv_slapse.nodes.scene_output import SceneOutput
from mv_slapse.nodes.shell import BACKWARDS, run, Shell
from mv_slapse.nodes.speeds import Speeds
from mv_slapse.records import Extraction, Label
from mv_slapse.ros_frames import RosFrames
from mv_slapse.scene.filter import SceneFilter
from mv_slapse_msgs.msg import PlaneObservations

TOPIC = 'planes/observations'
HELD = 100  # pairs kept until the camera's place on the robot is known


class SlamNode(Shell):
    """ROS side of SceneFilter."""

    def __init__(self, **kwargs):
        """Join the topics."""
        super().__init__('slam', **kwargs)
        self._extrinsics = Extrinsics(self)
        self._output, self._archive = SceneOutput(self), Archive(self)
        self._handovers = Handovers(self, Label.STATIONARY)
        self._speeds, self._placement = Speeds(self), Placement(self)
        self._known = KnownPlace(self, self._placement)
        self._gate = Gate(self._is_ready, self._step, HELD)
        self.restart()
        self.keep_draining(TOPIC, self._gate)
        self.health.watch(TOPIC, 'start the plane_extraction node in the same namespace')
        subscribe(self, PlaneObservations, TOPIC,
                  self.guarded(TOPIC, PlaneObservations, self._take), RELIABLE)

    def restart(self):
        """Begin a new trajectory and a new map."""
        self._placement.restart()
        for part in (self._output, self._archive, self._known):
            part.restart()
        self._renew()

    def go_on(self):
        """Begin a new map where the last pose was."""
        self._placement.go_on()
        self.count_reset()
        self.health.restarted()
        self._renew()

    def on_settings(self, changed: set[type]):
        """Go on with new settings of the filter."""
        if SceneSettings in changed:
            self.go_on()

    def _renew(self):
        self._filter, self._newest = SceneFilter(self.settings[SceneSettings]), 0
        for part in (self._handovers, self._speeds):
            part.restart()

    def _is_ready(self, _extraction: Extraction, frame: str, _came: float) -> bool:
        return self._extrinsics.frames(frame) is not None

    def _take(self, msg: PlaneObservations):
        self._gate(fields.extraction_from_message(msg), msg.header.frame_id, self.latency.came)

    def _step(self, extraction: Extraction, frame: str, came: float):
        if extraction.previous_stamp < self._newest - BACKWARDS:
            self.begin_anew('time went back (a bag played again?)')
        if self.latency.is_behind(came):
            extraction = overload.unseen(extraction)
        frames = self._placement.place(self._extrinsics.frames(frame))
        if 0 < self._newest < extraction.previous_stamp:
            self.health.count('gaps')
        self._advance(extraction, frames)

    def _advance(self, extraction: Extraction, frames: RosFrames):
        self._newest = max(self._newest, extraction.stamp)
        due = self._handovers.due(extraction.stamp - 1, frames)
        scene, given = self._filter.step(extraction, due, self._speeds.told(extraction.stamp))
        frames = self._known.look(scene, frames)
        self._archive.add(scene, extraction.previous_stamp, frames, self._placement.level)
        self._handovers.publish(given, frames)
        self._output.publish(scene, frames, self._placement)


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop; return the exit code."""
    return run(SlamNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
