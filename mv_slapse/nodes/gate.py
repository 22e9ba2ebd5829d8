"""Messages held back until what they need is known."""

from collections import deque
from collections.abc import Callable


class Gate:
    """Passes calls on in order once ``is_open``, asked with their arguments, says so.

    Until then the newest calls are kept. Once open it stays so.
    """

    def __init__(self, is_open: Callable[..., bool], passed: Callable[..., None], bound: int):
        """Hold at most ``bound`` calls of ``passed``."""
        self._is_open, self._passed = is_open, passed
        self._held: deque[tuple] = deque(maxlen=bound)
        self._has_opened = False

    def __call__(self, *args):
        """Pass a call on, or hold it."""
        self._held.append(args)
        self.drain()

    def drain(self):
        """Pass on what is held, if the gate is open."""
        while self._held and self._is_open(*self._held[0]):
            self._has_opened = True
            self._passed(*self._held.popleft())

    @property
    def is_done(self) -> bool:
        """Return whether nothing is or will be held back any more."""
        return self._has_opened and not self._held

    def clear(self):
        """Drop what is held."""
        self._held.clear()
