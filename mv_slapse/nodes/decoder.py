"""Encoded or raw video in, merged motion vectors out."""

from mv_slapse import fields
from mv_slapse.config import DecoderSettings, EncoderSettings
from mv_slapse.nodes.conversions import to_message
from mv_slapse.nodes.decoding import Decoding
from mv_slapse.nodes.image_overlay import OverlayTopics
from mv_slapse.nodes.qos import RELIABLE
from mv_slapse.nodes.shell import run, Shell
from mv_slapse.records import Correspondences, SegmentKind
from mv_slapse.ros_frames import RosFrames
from mv_slapse_msgs.msg import Correspondences as CorrespondencesMsg


class DecoderNode(Shell):
    """ROS side of CorrespondenceDecoder."""

    def __init__(self, **kwargs):
        """Join the topics."""
        super().__init__('decoder', **kwargs)
        self._publisher = self.create_publisher(CorrespondencesMsg, 'correspondences', RELIABLE)
        self._decoding = Decoding(self, self._publish)
        self._found = OverlayTopics(self, self._decoding.overlay)

    def restart(self):
        """Forget the stream."""
        self._decoding.restart()

    def on_settings(self, changed: set[type]):
        """Decode with new settings from the next key picture on."""
        if changed & {EncoderSettings, DecoderSettings}:
            self.begin_anew('decoder settings changed')

    def destroy_node(self):
        """Stop the reader of a source first."""
        self._decoding.close()
        super().destroy_node()

    def _publish(self, record: Correspondences, frame: str):
        self._publisher.publish(to_message(CorrespondencesMsg, fields.correspondences_to_fields(
            record, RosFrames(camera=frame))))
        if record.kind != SegmentKind.BROKEN:
            self.health.worked()


def main(args: list[str] | None = None) -> int:
    """Run the node until it is told to stop; return the exit code."""
    return run(DecoderNode, args)


if __name__ == '__main__':
    raise SystemExit(main())
