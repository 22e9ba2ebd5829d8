"""A process that has everything loaded, and forks the node again when a signal ended it.

Loading Python, numpy and the middleware takes four fifths of a node's start, some second of CPU
time. A process that stays behind with all of it loaded, and has no part in ROS itself, has the
next one at work in the rest.
"""

from contextlib import closing, suppress
import ctypes
import gc
import os
from pathlib import Path
import signal
import socket
import sys
import tempfile
import time

from rclpy.logging import get_logger
from rclpy.utilities import get_rmw_implementation_identifier

OPTION = '--standby'
DELAY = 0.1  # [s] before it is started again, so that one that cannot live does not spin
PR_SET_PDEATHSIG = 1
SIGNALS = signal.SIGINT, signal.SIGTERM
FAST_DDS = 'rmw_fastrtps_cpp'
PROFILES = 'FASTRTPS_DEFAULT_PROFILES_FILE'  # the variable, and the file that is read without it
PROFILES_HERE = 'DEFAULT_FASTRTPS_PROFILES.xml'
PROFILE = """<?xml version="1.0" encoding="UTF-8"?>
<dds xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles"><profiles>
<participant profile_name="mv_slapse" is_default_profile="true">
<rtps><participantID>{}</participantID></rtps></participant></profiles></dds>
"""
# Of the 32 that rmw_fastrtps looks for where ROS_AUTOMATIC_DISCOVERY_RANGE is LOCALHOST: two
# beyond would never find each other. Those that start take the first ones.
PARTICIPANTS = range(16, 32)


def stand_by(words: list[str]) -> int | None:
    """Where the words of the command line say so, fork; return None in what is to be the node.

    The process left behind returns the node's exit code once it has ended by itself, or after a
    signal to end, which is handed on. A node that another signal ended is forked again.
    """
    if OPTION not in words:
        return None
    middleware = get_rmw_implementation_identifier()  # loads it
    gc.freeze()  # else the first collection copies every page that is shared
    code = 0
    left, number, ports = _Left(), os.getpid(), Ports(middleware)
    while not left.is_asked_to_end:
        left.child = os.fork()
        if not left.child:
            return _begin(number)
        left.hand_on()
        code = os.waitstatus_to_exitcode(os.waitpid(left.child, 0)[1])
        left.child = 0
        if code >= 0 or left.is_asked_to_end:
            break
        get_logger('mv_slapse').error(
            f'{signal.Signals(-code).name} has ended the node, it is started again')
        time.sleep(DELAY)
        ports.change()
    ports.close()
    return max(code, 0)


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


class Ports:
    """Lets each node that is forked again have ports that none before it had.

    Fast DDS gives it those of the killed one, whose shared memory the others go on writing to for
    one to three seconds: so long it would hear nobody. A profile of the user's own is left alone.
    """

    def __init__(self, middleware: str):
        self._is_needed = (middleware == FAST_DDS and PROFILES not in os.environ
                           and not Path(PROFILES_HERE).exists())
        self._next = os.getpid() % len(PARTICIPANTS)
        self._path = None

    def change(self):
        """Choose the ports of the next process that is forked."""
        order = *PARTICIPANTS[self._next:], *PARTICIPANTS[:self._next]
        free = next(filter(is_free, order), None) if self._is_needed else None
        if free is None:
            return
        self._next = (PARTICIPANTS.index(free) + 1) % len(PARTICIPANTS)
        with suppress(OSError):  # without it the node comes as well, only later
            if self._path is None:
                file, self._path = tempfile.mkstemp('.xml', 'mv_slapse_')
                os.close(file)
            Path(self._path).write_text(PROFILE.format(free))
            os.environ[PROFILES] = self._path

    def close(self):
        """Leave no file."""
        if self._path is not None:
            with suppress(OSError):
                os.unlink(self._path)


def is_free(participant: int) -> bool:
    """Return whether nobody has the first port of a participant (RTPS 2.2, 9.6.1.1)."""
    domain = int(os.environ.get('ROS_DOMAIN_ID') or 0)
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
        try:
            probe.bind(('', 7410 + 250 * domain + 2 * participant))
        except (OSError, OverflowError):
            return False
    return True
