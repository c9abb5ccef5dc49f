"""Lossless pixel coding, small and cheap: each row as differences, entropy-coded.

A camera's noise leaves little for a search for repetitions, so there is none: coding takes milliseconds. For
wide pixels the low and the high bytes are coded separately.
"""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

from ronna_hw.bounded_input import inflate

Pixels = NDArray[np.uint8] | NDArray[np.uint16]
TYPES: dict[str, type[np.uint8 | np.uint16]] = {"uint8": np.uint8, "uint16": np.uint16}
LARGEST_BYTES = 50_000_000  # ten times a full sensor of ours
CENTRE = 0x80  # small differences of either sign around it: their high byte is then almost constant


def pack_pixels(pixels: Pixels) -> bytes:
    """Any 2-D array of 8 or 16 bits."""
    rows = pixels.copy()
    rows[:, 1:] -= pixels[:, :-1]  # wraps around, and back again
    rows += rows.dtype.type(CENTRE)
    planes = rows.view(np.uint8).reshape(-1, rows.itemsize)
    coder = zlib.compressobj(1, zlib.DEFLATED, zlib.MAX_WBITS, zlib.DEF_MEM_LEVEL, zlib.Z_HUFFMAN_ONLY)
    coded = [coder.compress(planes[:, byte].tobytes()) for byte in range(rows.itemsize)]
    return b"".join(coded) + coder.flush()


def unpack_pixels(packed: bytes, shape: tuple[int, int], kind: str) -> Pixels:
    """The array back, read-only. Raises ValueError if the bytes do not form one."""
    if kind not in TYPES:
        raise ValueError(f"{kind} is not a pixel type")
    wanted = np.dtype(TYPES[kind])
    raw = np.frombuffer(inflate(packed, LARGEST_BYTES), dtype=np.uint8)
    planes = raw.reshape(wanted.itemsize, *shape)
    rows = np.moveaxis(planes, 0, -1).copy(order="C").view(wanted).reshape(shape)
    rows -= rows.dtype.type(CENTRE)
    pixels: Pixels = np.cumsum(rows, axis=1, dtype=wanted)
    pixels.flags.writeable = False
    return pixels
