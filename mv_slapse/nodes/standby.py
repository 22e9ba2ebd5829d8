"""A process that has everything loaded, and forks the node again when a signal ended it.

Loading Python, numpy and the middleware takes four fifths of a node's start, some second of CPU
time. A process that stays behind with all of it loaded, and has no part in ROS itself, has the
next one at work in the rest.
"""

from contextlib import suppress
import ctypes
import gc
import os
import signal
import sys
import time

from rclpy.logging import get_logger
from rclpy.utilities import get_rmw_implementation_identifier

OPTION = '--standby'
DELAY = 0.1  # [s] before it is started again, so that one that cannot live does not spin
PR_SET_PDEATHSIG = 1
SIGNALS = signal.SIGINT, signal.SIGTERM


def stand_by(words: list[str]) -> int | None:
    """Where the words of the command line say so, fork; return None in what is to be the node.

    The process left behind returns the node's exit code once it has ended by itself, or after a
    signal to end, which is handed on. A node that another signal ended is forked again.
    """
    if OPTION not in words:
        return None
    get_rmw_implementation_identifier()  # loads the middleware
    gc.freeze()  # else the first collection copies every page that is shared
    left, number = _Left(), os.getpid()
    while not left.is_asked_to_end:
        left.child = os.fork()
        if not left.child:
            return _begin(number)
        left.hand_on()
        code = os.waitstatus_to_exitcode(os.waitpid(left.child, 0)[1])
        left.child = 0
        if code >= 0 or left.is_asked_to_end:
            return max(code, 0)
        get_logger('mv_slapse').error(
            f'{signal.Signals(-code).name} has ended the node, it is started again')
        time.sleep(DELAY)
    return 0


def _begin(parent: int) -> None:
    """Be the node: end with the process left behind, and hear of Ctrl-C from it alone."""
    for number in SIGNALS:
        signal.signal(number, signal.SIG_DFL)
    os.setpgid(0, 0)
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)
    if os.getppid() != parent:
        sys.exit(1)


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
