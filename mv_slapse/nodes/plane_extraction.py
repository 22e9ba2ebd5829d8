"""Merged motion vectors in; camera motion and labelled planes of each key frame pair out."""

from mv_slapse import fields
from mv_slapse.calibration import check_size
from mv_slapse.config import ExtractionSettings, MountSettings
from mv_slapse.extraction.extractor import PlaneExtractor
from mv_slapse.geometry.camera import Camera
from mv_slapse.nodes import overload
from mv_slapse.nodes.camera_input import CameraInput
from mv_slapse.nodes.conversions import to_message
from mv_slapse.nodes.gate import Gate
from mv_slapse.nodes.numbering import Numbering
from mv_slapse.nodes.qos import RELIABLE, subscribe
from mv_slapse.nodes.shell import run, Shell
from mv_slapse.records import Correspondences as RecordedPair
from mv_slapse.records import Extraction
from mv_slapse.ros_frames import RosFrames
from mv_slapse_msgs.msg import Correspondences, PlaneObservations

TOPIC = 'correspondences'
HELD = 100  # pairs kept until the camera is known


class PlaneExtractionNode(Shell):
    """ROS side of PlaneExtractor."""

    def __init__(self, **kwargs):
        """Join the topics."""
        super().__init__('plane_extraction', **kwargs)
        self._extractor: PlaneExtractor | None = None
        self._publisher = self.create_publisher(PlaneObservations, 'planes/observations',
                                                RELIABLE)
        self._numbering = Numbering(self)
        self._gate = Gate(self._is_ready, self._extract, HELD)
        self.keep_draining(TOPIC, self._gate)
        self._camera = CameraInput(self, self._on_camera)
        self.health.watch(TOPIC, 'start the decoder node in the same namespace')
        subscribe(self, Correspondences, TOPIC, self.guarded(TOPIC, Correspondences, self._take))

    def restart(self):
        """Forget all planes."""
        self._numbering.begin_anew()
        if self._camera.camera is not None:
            self._start(self._camera.camera)

    def on_settings(self, changed: set[type]):
        """Extract with new settings."""
        if changed & {ExtractionSettings, MountSettings}:
            self.begin_anew('extraction settings changed')

    def _is_ready(self, *_) -> bool:
        return self._extractor is not None and self._numbering.is_known()

    def _take(self, msg: Correspondences):
        record = fields.correspondences_from_message(msg)
        self._gate(record, msg.header.frame_id, self.latency.came)

    def _start(self, camera: Camera):
        self._extractor = PlaneExtractor(camera, self.settings[ExtractionSettings],
                                         self.settings[MountSettings].camera_height)

    def _on_camera(self, camera: Camera):
        self._start(camera)
        self._gate.drain()

    def _extract(self, record: RecordedPair, frame: str, came: float):
        check_size(self._camera.camera, record.width, record.height, TOPIC)
        if self.latency.is_behind(came):
            record = overload.dropped(record)
        extraction = self._numbering.applied(self._extractor.extract(record))
        self._publisher.publish(to_message(PlaneObservations, fields.extraction_to_fields(
            extraction, RosFrames(camera=frame))))
        self._report(extraction)

    def _report(self, extraction: Extraction):
        self.health.count('key frame pairs')
        self.health.fresh('planes', len(extraction.planes))
        self.health.set('no_motion', bool(extraction.reason),
                        f'the camera\'s motion is not known: {extraction.reason}')
        if not extraction.reason:
            self.health.worked()


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop; return the exit code."""
    return run(PlaneExtractionNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
