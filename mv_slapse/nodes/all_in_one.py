"""Video in, everything out, in one process: arrays are passed in memory."""

from mv_slapse import fields
from mv_slapse.config import (
    DecoderSettings,
    ExtractionSettings,
    ObstacleSettings,
    SceneSettings,
    Settings,
)
from mv_slapse.geometry.camera import Camera
from mv_slapse.nodes import overload
from mv_slapse.nodes.archive import Archive
from mv_slapse.nodes.conversions import to_message
from mv_slapse.nodes.decoding import Decoding
from mv_slapse.nodes.extrinsics import Extrinsics
from mv_slapse.nodes.gate import Gate
from mv_slapse.nodes.handovers import Handovers
from mv_slapse.nodes.known_place import KnownPlace
from mv_slapse.nodes.obstacle_output import ObstacleOutput
from mv_slapse.nodes.placement import Placement
from mv_slapse.nodes.qos import is_heard, RELIABLE
from mv_slapse.nodes.scene_output import SceneOutput
from mv_slapse.nodes.settings import CORE
from mv_slapse.nodes.shell import run, Shell
from mv_slapse.nodes.speeds import Speeds
from mv_slapse.pipeline import Slapse, Step
from mv_slapse.records import Correspondences
from mv_slapse_msgs.msg import Correspondences as CorrespondencesMsg
from mv_slapse_msgs.msg import PlaneObservations

HELD = 100  # pairs kept until the camera's place on the robot is known


class AllInOneNode(Shell):
    """ROS side of Slapse."""

    def __init__(self, **kwargs):
        """Join the topics."""
        super().__init__('all_in_one', **kwargs)
        self._camera: Camera | None = None
        self._slapse: Slapse | None = None
        self._extrinsics, self._archive = Extrinsics(self), Archive(self)
        self._correspondences = self.create_publisher(CorrespondencesMsg, 'correspondences',
                                                      RELIABLE)
        self._observations = self.create_publisher(PlaneObservations, 'planes/observations',
                                                   RELIABLE)
        self._scene, self._obstacles = SceneOutput(self), ObstacleOutput(self)
        self._handovers, self._speeds = Handovers(self, None), Speeds(self)
        self._placement = Placement(self)
        self._known = KnownPlace(self, self._placement)
        self._gate = Gate(self._is_ready, self._step, HELD)
        self.keep_draining('video', self._gate)
        self._decoding = Decoding(self, self._take, self._on_camera)

    def restart(self):
        """Begin a new trajectory and a new map."""
        for part in (self._placement, self._scene, self._archive, self._known):
            part.restart()
        self._renew()

    def go_on(self):
        """Begin a new map where the last pose was."""
        self._placement.go_on()
        self._archive.begin_anew()
        self.count_reset()
        self.health.restarted()
        self._renew()

    def on_settings(self, changed: set[type]):
        """Go on with new settings of the core."""
        if changed & set(CORE):
            self.go_on()

    def _renew(self):
        self._decoding.restart()
        self._gate.clear()
        self._speeds.restart()
        if self._camera is not None:
            self._on_camera(self._camera)

    def destroy_node(self):
        """Stop the reader of a source first."""
        self._decoding.close()
        super().destroy_node()

    def _core_settings(self) -> Settings:
        return Settings(decoder=self.settings[DecoderSettings],
                        extraction=self.settings[ExtractionSettings],
                        scene=self.settings[SceneSettings],
                        obstacles=self.settings[ObstacleSettings])

    def _on_camera(self, camera: Camera):
        self._camera = camera
        self._slapse = Slapse(camera, self._core_settings())

    def _is_ready(self, _record: Correspondences, frame: str, _came: float) -> bool:
        return self._extrinsics.frames(frame) is not None

    def _take(self, record: Correspondences, frame: str):
        self._gate(record, frame, self.latency.came)

    def _step(self, record: Correspondences, frame: str, came: float):
        if self.latency.is_behind(came):
            record = overload.dropped(record)
        step = self._slapse.step(record, self._speeds.told(record.stamp))
        frames = self._known.look(step.scene, self._extrinsics.frames(frame))
        self._archive.add(step.scene, record.previous_stamp, frames, self._placement.level)
        self._publish(step, frames)
        reason = step.extraction.reason
        self.health.set('no_motion', bool(reason), f'the camera\'s motion is not known: {reason}')

    def _publish(self, step: Step, frames):
        # what stays inside this process is made a message only for who listens
        if is_heard(self._correspondences):
            self._correspondences.publish(to_message(CorrespondencesMsg, (
                fields.correspondences_to_fields(step.correspondences, frames))))
        if is_heard(self._observations):
            self._observations.publish(to_message(
                PlaneObservations, fields.extraction_to_fields(step.extraction, frames)))
        self._handovers.publish(step.handovers, frames)
        self._scene.publish(step.scene, frames, self._placement)
        self._obstacles.publish(step.scene.stamp, list(step.obstacles), step.scene.scale_status,
                                frames)
        self.attempt('image_overlay', self._decoding.overlay.show, step.extraction,
                     step.obstacles, step.scene.scale_status, frames.camera,
                     recover=lambda: None)


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop; return the exit code."""
    return run(AllInOneNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
