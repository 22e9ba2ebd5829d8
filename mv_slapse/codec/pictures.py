"""The pictures of a video, for what encodes them anew; nothing else here looks at pixels."""

from collections.abc import Iterator
from pathlib import Path

import av
from mv_slapse.errors import UnusableInput
import numpy as np


def pictures(path: str | Path) -> Iterator[np.ndarray]:
    """Yield the pictures of a video file, (height, width) uint8 grey, in order of presentation.

    Raises
    ------
    UnusableInput
        Where it cannot be read.
    """
    try:
        with av.open(str(path)) as container:
            for frame in container.decode(video=0):
                yield frame.to_ndarray(format='gray')
    except (av.error.FFmpegError, OSError, IndexError) as error:
        raise UnusableInput(f'{path} cannot be read as a video: {error}; give a video file that '
                            'FFmpeg can read') from error
