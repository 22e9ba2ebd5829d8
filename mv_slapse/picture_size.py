"""The size that a JPEG or PNG tells in its header, before memory is taken for the picture."""

PNG = b'\x89PNG\r\n\x1a\n'
JPEG = b'\xff\xd8'
STILLS = PNG, JPEG  # what their data begin with
FRAMES = {*range(0xc0, 0xd0)} - {0xc4, 0xc8, 0xcc}  # markers SOF0 to SOF15, ITU-T T.81 table B.1
BARE = {0x01, *range(0xd0, 0xd9)}  # markers without a length


def size_of_still(data: bytes) -> tuple[int, int] | None:
    """Return width and height [px], or None where the bytes are neither JPEG nor PNG."""
    if data.startswith(PNG):
        at = len(PNG) + 8  # length and name of the chunk IHDR
        return _number(data, at, 4), _number(data, at + 4, 4)
    return _size_of_jpeg(data) if data.startswith(JPEG) else None


def _size_of_jpeg(data: bytes) -> tuple[int, int] | None:
    at = len(JPEG)
    while at + 9 <= len(data) and data[at] == 0xff:
        marker = data[at + 1]
        if marker in FRAMES:
            return _number(data, at + 7, 2), _number(data, at + 5, 2)
        at += 1 if marker == 0xff else 2 if marker in BARE else 2 + _number(data, at + 2, 2)
    return None


def _number(data: bytes, at: int, n: int) -> int:
    return int.from_bytes(data[at:at + n], 'big')
