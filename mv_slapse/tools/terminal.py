"""Standard output, which may be a file on a full disk, or a reader that has gone."""

import os
import sys

from mv_slapse.storage import whole_files


def say(text: str):
    """Print a text at once.

    Raises
    ------
    UnusableOutput, BrokenPipeError
        Where it cannot be written; where its reader has gone. What is printed later is lost.
    """
    try:
        print(text, flush=True)
    except OSError as error:
        # what waits to be printed would fail once more when Python ends
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        if isinstance(error, BrokenPipeError):
            raise
        raise whole_files.unusable('standard output', error) from error
