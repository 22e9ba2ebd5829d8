"""A process that has everything loaded, and forks the node again when a signal ended it.

Loading Python, numpy and the middleware takes four fifths of a node's start, some second of CPU
time. A process stays behind with all of it loaded, and has no part in ROS itself. One that it has
forked waits to be the next node, as a participant that all others know by now: Fast DDS announces
a participant before it can hear, others answer its first announcement only, and who has not heard
that answer knows nothing of them until they announce themselves again, up to 3 s later.

It hears by UDP alone. Others go on writing to a killed node in shared memory for some 20 s, until
they take it for gone, and that may keep what they publish from others, too, from the next node
among them (Fast DDS, issue 5469): one of some 30 kills, one each 4 s, left the video silent.
"""

from contextlib import suppress
import ctypes
import faulthandler
import gc
import os
import select
import signal
import sys
import time

import rclpy
from rclpy.logging import get_logger
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.signals import SignalHandlerOptions
from rclpy.type_support import check_for_type_support
from rclpy.utilities import get_rmw_implementation_identifier

OPTION = '--standby'
DELAY = 0.1  # [s] before it is started again, so that one that cannot live does not spin
PLACE = '_mv_slapse_'  # of the hidden node, before the process' number
END_TIME = 2.0  # [s] after which one that waited, and cannot end, is ended
CALM = 3.0  # [s] before the next one takes part in ROS, so that the node itself starts first
PR_SET_PDEATHSIG = 1
TRANSPORTS = 'FASTDDS_BUILTIN_TRANSPORTS'
SIGNALS = signal.SIGINT, signal.SIGTERM


def stand_by(words: list[str]) -> tuple[int | None, Node | None]:
    """Where the words of the command line say so, fork; return no code in what is to be the node.

    The process left behind returns the node's exit code once it has ended by itself, or after a
    signal to end, which is handed on. A node that another signal ended is followed by the one that
    waits. That may be in ROS by then, with the node that is returned, which holds its place.
    """
    if OPTION not in words:
        return None, None
    get_rmw_implementation_identifier()  # loads it
    load_type_supports()
    gc.freeze()  # else the first collection copies every page that is shared
    code, left, number = 0, _Left(), os.getpid()
    follower = _Follower()
    while follower.number and not left.is_asked_to_end:
        left.child = follower.number
        follower.begin()
        left.hand_on()
        follower = _Follower()
        if follower.number:
            code = os.waitstatus_to_exitcode(os.waitpid(left.child, 0)[1])
            left.child = 0
            if code >= 0 or left.is_asked_to_end:
                break
            get_logger('mv_slapse').error(
                f'{signal.Signals(-code).name} has ended the node, it is started again')
            time.sleep(DELAY)
    if not follower.number:
        return None, follower.wait(words, number)
    follower.end()
    return max(code, 0), None


def load_type_supports():
    """Load what the first publisher of each type would load: most of what a node takes then."""
    for name in [name for name in sys.modules if name.endswith(('.msg', '.srv'))]:
        for item in list(vars(sys.modules[name]).values()):
            if hasattr(type(item), '__import_type_support__'):
                check_for_type_support(item)


class _Follower:
    """A process that is forked when this is made, and waits to be the node.

    Attributes
    ----------
    number : int
        Of the process; 0 in itself.
    """

    def __init__(self):
        self._reader, self._writer = os.pipe()
        self.number = os.fork()
        os.close(self._reader if self.number else self._writer)

    def begin(self):
        """Let it be the node; one that was killed meanwhile is missed when it is waited for."""
        with suppress(BrokenPipeError):
            os.write(self._writer, b'.')
        os.close(self._writer)

    def end(self):
        """Let it end, and wait for that."""
        os.close(self._writer)
        os.waitpid(self.number, 0)

    def wait(self, words: list[str], parent: int) -> Node | None:
        """Wait in the process itself until it is to be the node; it may end here.

        It ends with the process left behind, and hears of Ctrl-C from that alone.
        """
        for number in SIGNALS:
            signal.signal(number, signal.SIG_DFL)
        os.setpgid(0, 0)
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() != parent:
            sys.exit(1)
        place = None
        if not select.select([self._reader], [], [], CALM)[0]:
            place = _place(words)
        if os.read(self._reader, 1):
            os.close(self._reader)
            return place
        faulthandler.dump_traceback_later(END_TIME, exit=True)
        if place is not None:
            place.destroy_node()
        rclpy.try_shutdown()
        os._exit(0)


def _place(words: list[str]) -> Node | None:
    """Take part in ROS with next to nothing, where that is allowed.

    The rights of the node's enclave suffice: of this one's name, which no policy can know, there
    is nothing.
    """
    os.environ.setdefault(TRANSPORTS, 'UDPv4')
    try:
        rclpy.init(args=words, signal_handler_options=SignalHandlerOptions.NO)
        silent = Parameter('start_type_description_service', value=False)
        return rclpy.create_node(f'{PLACE}{os.getpid()}', use_global_arguments=False,
                                 enable_rosout=False, start_parameter_services=False,
                                 parameter_overrides=[silent])
    except Exception as error:
        get_logger('mv_slapse').warning(f'a node that is killed will be back late: {error}')
        return None


class _Left:
    """What the process left behind knows: its child, and whether it is to end."""

    def __init__(self):
        self.child, self.is_asked_to_end = 0, False
        self._number = 0
        for number in SIGNALS:
            signal.signal(number, self._ask)

    def _ask(self, number, _frame):
        self.is_asked_to_end, self._number = True, number
        self.hand_on()

    def hand_on(self):
        """Tell the child of a signal that came, also where it came before the child was known."""
        if self._number and self.child:
            with suppress(ProcessLookupError):
                os.kill(self.child, self._number)
