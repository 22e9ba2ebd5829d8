"""Six ways to damage bytes, by a seed."""

from collections.abc import Callable

from mv_slapse.codec.packet import Packet
import numpy as np


def flip(data: bytes, rng: np.random.Generator) -> bytes:
    """Flip up to eight bits."""
    content = bytearray(data)
    for at in rng.integers(0, max(len(data), 1), rng.integers(1, 9)):
        if content:
            content[at] ^= 1 << rng.integers(8)
    return bytes(content)


def zero(data: bytes, rng: np.random.Generator) -> bytes:
    """Set up to 64 bytes to zero."""
    at = int(rng.integers(0, max(len(data), 1)))
    return data[:at] + bytes(len(data[at:at + 64])) + data[at + 64:]


def noise(data: bytes, rng: np.random.Generator) -> bytes:
    """Put noise in the place of up to 64 bytes."""
    at = int(rng.integers(0, max(len(data), 1)))
    return data[:at] + rng.bytes(len(data[at:at + 64])) + data[at + 64:]


def cut(data: bytes, rng: np.random.Generator) -> bytes:
    """Leave out the end."""
    return data[:int(rng.integers(0, max(len(data), 1)))]


def remove(data: bytes, rng: np.random.Generator) -> bytes:
    """Leave out up to 64 bytes within."""
    at = int(rng.integers(0, max(len(data), 1)))
    return data[:at] + data[at + int(rng.integers(1, 65)):]


def repeat(data: bytes, rng: np.random.Generator) -> bytes:
    """Repeat up to 64 bytes."""
    at = int(rng.integers(0, max(len(data), 1)))
    return data[:at] + 2 * data[at:at + int(rng.integers(1, 65))] + data[at + 64:]


MUTATIONS: tuple[Callable[[bytes, np.random.Generator], bytes], ...] = (
    flip, zero, noise, cut, remove, repeat)
EXTREMES = (-(1 << 63), -(1 << 61), -1, 0, 1, 1 << 31, 1 << 61, 1 << 62)


def damaged(packets: list[Packet], kind: int, rng: np.random.Generator) -> list[Packet]:
    """Return packets of which some are damaged, lost, doubled, exchanged or stamped wrongly."""
    out = []
    for packet in packets:
        chance = rng.random()
        data, stamp = packet.data, packet.stamp
        if chance < 0.15:
            data = MUTATIONS[kind](data, rng)
        elif chance < 0.18:
            continue
        elif chance < 0.20 and out:
            out.insert(len(out) - 1, packet)
            continue
        elif chance < 0.21:
            stamp = int(rng.choice(EXTREMES)) + int(rng.integers(-2, 3))
        out.append(Packet(data, stamp, packet.is_key, packet.codec, packet.extradata))
    return out
