"""A progress bar where somebody watches."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
import sys

from tqdm import tqdm


@contextmanager
def progress_bar(is_quiet: bool) -> Iterator[Callable[[int, int], None]]:
    """Give a function of (pictures done, pictures in all or 0) that draws on a terminal."""
    with tqdm(unit=' frames', disable=is_quiet or not sys.stderr.isatty(), leave=False) as bar:
        def show(done: int, total: int):
            """Draw how many pictures are done."""
            bar.total = total or None
            bar.update(done - bar.n)

        yield show
