"""Video from a file or a URL, read in a thread of its own."""

from collections.abc import Callable
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Event, Thread
import time

from mv_slapse.codec.packet import Packet
from mv_slapse.codec.source import open_source
from mv_slapse.nodes.health import HINDERS
from mv_slapse.nodes.settings import require, STAMP_ORIGINS, VideoSettings
from mv_slapse.nodes.shell import Shell

QUEUE_LENGTH = 32
LIVE_LENGTH = 600  # packets: the node drops what waits too long, the reader must not wait


class VideoSource:
    """Hands packets of ``source`` to the node's executor; the reader waits when it is behind."""

    def __init__(self, node: Shell, deliver: Callable[[Packet, str], None],
                 finish: Callable[[], None]):
        """Open the source and start to read it."""
        settings = node.settings[VideoSettings]
        self._node, self._deliver, self._finish = node, deliver, finish
        self._frame = settings.camera_frame or 'camera_optical'
        self._source = open_source(settings.source)
        live = '://' in settings.source and not settings.source.startswith('file:')
        self._is_live = live or Path(settings.source).is_char_device()
        self._pace = _Pace(0.0 if self._is_live else settings.source_rate)
        origin = require('stamp_origin', settings.stamp_origin, STAMP_ORIGINS)
        self._start = node.get_clock().now().nanoseconds if origin == 'clock' else 0
        self._queue: Queue = Queue(LIVE_LENGTH if self._is_live else QUEUE_LENGTH)
        self._stop = Event()
        self._guard = node.create_guard_condition(self._drain)
        self._thread = Thread(target=self._read, daemon=True)
        self._thread.start()

    def restart(self):
        """Go on where the source is."""

    def close(self):
        """Stop reading; a reader that hangs in the network is left to the process' end."""
        self._stop.set()
        self._thread.join(timeout=1.0)

    def _read(self):
        """Read to the end; what goes wrong is handed on like a packet, and ends the reading."""
        ending = None
        try:
            for packet in self._source.packets():
                self._pace.wait(packet.stamp, self._stop)
                if not self._put(packet):
                    break
            self._source.close()
        except Exception as error:
            ending = error
        self._put(ending)

    def _put(self, item: Packet | Exception | None) -> bool:
        """Queue what was read; only a file can wait, a live stream goes on."""
        while not self._stop.is_set():
            try:
                self._queue.put((item, time.monotonic()), timeout=0.1)
            except Full:
                continue
            self._guard.trigger()
            return True
        return False

    def _drain(self):
        """Take one packet and ask to be called again, so that services stay responsive."""
        try:
            item, came = self._queue.get_nowait()
        except Empty:
            return
        if not isinstance(item, Packet):
            self._end(item)
        elif not self._node.paused:
            moved = Packet(item.data, item.stamp + self._start, item.is_key, item.codec,
                           item.extradata)
            self._node.latency.begin(time.monotonic() - came if self._is_live else 0.0)
            self._node.attempt('source', self._deliver, moved, self._frame)
        self._guard.trigger()

    def _end(self, error: Exception | None):
        health = self._node.health
        if error is None:
            self._node.attempt('source', self._finish)
            self._node.get_logger().info('end of the source')
        else:
            self._node.fault('source', error)
        health.leave(*HINDERS, 'overload')
        said = f'the source broke off ({error}): check it and start' if error else (
            'the source ended: start')
        health.enter('ended', f'{said} the node again to play it again')


class _Pace:
    """Makes a file last as long as it shows; ``rate`` 0 does not wait."""

    def __init__(self, rate: float):
        self._rate, self._begin, self._newest = rate, time.monotonic(), 0

    def wait(self, stamp: int, stop: Event):
        """Wait until a packet of this stamp [ns] is due, or for ``stop``."""
        # stamps of packets go back and forth where there are B frames
        self._newest = max(self._newest, stamp)
        if self._rate > 0:
            due = self._begin + self._newest / 1e9 / self._rate
            stop.wait(max(0.0, due - time.monotonic()))
