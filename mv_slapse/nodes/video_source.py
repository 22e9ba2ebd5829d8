"""Video from a file or a URL, read in a thread of its own."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from queue import Empty, Full, Queue
from threading import Event, Thread
import time

from mv_slapse.codec.packet import Packet
from mv_slapse.codec.source import check_protocol, is_live, open_source, Source
from mv_slapse.nodes.health import HINDERS
from mv_slapse.nodes.settings import require, STAMP_ORIGINS, VideoSettings
from mv_slapse.nodes.shell import Shell

QUEUE_LENGTH = 32
FIRST_WAIT, LONGEST_WAIT = 0.5, 8.0  # [s] before a live source is opened again
LIVE_LENGTH = 600  # packets: the node drops what waits too long, the reader must not wait


class VideoSource:
    """Hands packets of ``source`` to the node's executor; the reader waits when it is behind.

    A camera, or a stream of the network, that is not there or breaks off is opened again, after a
    wait that doubles from FIRST_WAIT to LONGEST_WAIT.
    """

    def __init__(self, node: Shell, deliver: Callable[[Packet, str], None],
                 finish: Callable[[], None], interrupt: Callable[[str], None]):
        """Start to read; a file is opened here, so that a wrong one ends the node.

        ``interrupt`` is told why where a stream begins anew.
        """
        settings = node.settings[VideoSettings]
        self._node, self._deliver, self._finish = node, deliver, finish
        self._interrupt = interrupt
        self._frame = settings.camera_frame or 'camera_optical'
        self._name = settings.source
        check_protocol(self._name)
        self._is_live = is_live(self._name)
        self._waits = not self._is_live  # for the node: what comes was there before
        self._rate = settings.source_rate
        self._origin = require('stamp_origin', settings.stamp_origin, STAMP_ORIGINS)
        self._start: int | None = None
        self._last, self._at = 0, 0.0
        self._queue: Queue = Queue(LIVE_LENGTH if self._is_live else QUEUE_LENGTH)
        self._stop = Event()
        self._guard = node.create_guard_condition(self._drain)
        first = None if self._is_live else open_source(self._name)
        self._thread = Thread(target=self._read, args=(first,), daemon=True)
        self._thread.start()

    def restart(self):
        """Go on where the source is."""

    def close(self):
        """Stop reading; a reader that hangs in the network is left to the process' end."""
        self._stop.set()
        self._thread.join(timeout=1.0)

    def _read(self, source: Source | None):
        """Read to the end; what goes wrong is handed on like a packet."""
        wait = FIRST_WAIT
        while not self._stop.is_set():
            ending: Exception | None = None
            try:
                source = source or open_source(self._name)
                has_end = source.has_end
                self._waits = has_end or not self._is_live  # a file, maybe of the network
                pace = _Pace(self._rate if self._waits else 0.0)
                for packet in source.packets():
                    wait = FIRST_WAIT
                    pace.wait(packet.stamp, self._stop)
                    if not self._put(packet):
                        break
                source.close()
            except Exception as error:
                ending, has_end = error, False
            if not self._is_live or has_end:
                self._put(_End(ending))
                return
            self._put(_Break(ending, wait))
            self._stop.wait(wait)
            source, wait = None, min(2 * wait, LONGEST_WAIT)

    def _put(self, item: '_Item') -> bool:
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
        if isinstance(item, _End):
            self._end(item.error)
        elif isinstance(item, _Break):
            self._break_off(item)
        elif not self._node.paused:
            moved = replace(item, stamp=item.stamp + self._offset())
            self._last, self._at = max(self._last, moved.stamp), time.monotonic()
            self._node.latency.begin(0.0 if self._waits else time.monotonic() - came)
            self._node.attempt('source', self._deliver, moved, self._frame)
        self._guard.trigger()

    def _offset(self) -> int:
        """Return what is added to the stamps [ns] of the source as it was opened last."""
        if self._start is None:
            self._node.health.leave('unreachable')
            # The first picture has stamp 0 each time; time may not go back.
            gap = time.monotonic() - self._at if self._at else 0.0
            self._start = self._last + round(gap * 1e9)
            if self._origin == 'clock':
                self._start = max(self._start, self._node.get_clock().now().nanoseconds)
        return self._start

    def _break_off(self, item: '_Break'):
        why = item.error or 'the stream ended'
        message = f'{why}; it is opened again in {item.wait:g} s'
        if self._start is not None:
            self._node.get_logger().warning(message)
            self._interrupt('the source broke off')
        self._start = None
        self._node.health.enter('unreachable', message)

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


@dataclass(frozen=True)
class _End:
    """The source has been read to its end, or to where it cannot be read."""

    error: Exception | None


@dataclass(frozen=True)
class _Break:
    """A live source is not there; it is opened again after ``wait`` seconds."""

    error: Exception | None
    wait: float


_Item = Packet | _End | _Break


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
