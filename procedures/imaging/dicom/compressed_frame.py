"""The size that a compressed frame declares, checked before a decoder trusts it.

Decoders allocate whatever the frame declares; one of them aborts the whole program if that is too much.
"""

from __future__ import annotations

import struct
from itertools import pairwise

from ronna_hw.bounded_input import InputRefused

RLE = "1.2.840.10008.1.2.5"
JPEG_2000 = tuple(f"1.2.840.10008.1.2.4.{number}" for number in (90, 91, 201, 202, 203))
JPEG = tuple(f"1.2.840.10008.1.2.4.{number}" for number in (50, 51, 57, 70, 80, 81))  # and JPEG-LS

MOST_TILES = 1024  # in JPEG 2000; each costs kilobytes
RLE_SLACK_BYTES = 1024  # a segment may be padded

_START = b"\xff\xd8"
_SIZES = frozenset({*range(0xC0, 0xD0), 0xF7}) - {0xC4, 0xC8, 0xCC}  # frame headers; F7 is JPEG-LS
_J2K_START = b"\xff\x4f\xff\x51"
_J2K_SIZE = struct.Struct(">2H8IH")  # length, capabilities, image, its offset, tile, its offset, components
_RLE_HEADER = struct.Struct("<16I")


def check_frame(syntax: str, frame: bytes, shape: tuple[int, ...], pixel_bytes: int) -> None:
    """Raise InputRefused unless the frame decodes to this shape (rows, columns) with one component.

    Frames of other syntaxes pass: no decoder accepts them.
    """
    try:
        if syntax == RLE:
            _check_runs(frame, shape[0] * shape[1], pixel_bytes)
        elif syntax in JPEG_2000:
            _check_size(_j2k_size(frame), shape)
        elif syntax in JPEG:
            _check_size(_jpeg_size(frame), shape)
    except (struct.error, IndexError) as problem:
        raise InputRefused("a compressed frame is cut off") from problem


def _check_size(size: tuple[int, int, int], shape: tuple[int, ...]) -> None:
    if size != (*shape, 1):
        rows, columns, components = size
        raise InputRefused(
            "a compressed frame has the wrong size",
            expected=f"{shape[0]} x {shape[1]} of 1",
            got=f"{rows} x {columns} of {components}",
        )


def _jpeg_size(frame: bytes) -> tuple[int, int, int]:
    """Rows, columns, components of a JPEG or JPEG-LS frame (ITU T.81 B.2.2)."""
    place = len(_START) if frame.startswith(_START) else len(frame)
    while True:
        mark, kind, length = struct.unpack_from(">BBH", frame, place)
        if mark != 0xFF or length < 2:
            raise InputRefused("a compressed frame is not JPEG")
        if kind in _SIZES:
            rows, columns, components = struct.unpack_from(">HHB", frame, place + 5)
            return rows, columns, components
        place += 2 + length


def _j2k_size(frame: bytes) -> tuple[int, int, int]:
    """Rows, columns, components of a JPEG 2000 code stream (ITU T.800 A.5.1)."""
    if not frame.startswith(_J2K_START):
        raise InputRefused("a compressed frame is not JPEG 2000")
    _, _, x, y, x0, y0, tile_x, tile_y, _, _, components = _J2K_SIZE.unpack_from(frame, len(_J2K_START))
    if not tile_x or not tile_y or -(-x // tile_x) * -(-y // tile_y) > MOST_TILES:
        raise InputRefused("a compressed frame has too many tiles", limit=str(MOST_TILES))
    return y - y0, x - x0, components


def _check_runs(frame: bytes, pixels: int, pixel_bytes: int) -> None:
    """Check the segments of an RLE frame (PS3.5 annex G), one for each byte of a pixel."""
    count, *offsets = _RLE_HEADER.unpack_from(frame)
    limits = [*offsets[:pixel_bytes], len(frame)]
    if count != pixel_bytes or limits[0] < _RLE_HEADER.size or limits != sorted(limits):
        raise InputRefused("the segments of a compressed frame are not those of its pixels")
    made = sum(_run_bytes(frame[begin:end]) for begin, end in pairwise(limits))
    most = count * (pixels + RLE_SLACK_BYTES)
    if made > most:
        raise InputRefused("a compressed frame grows too large", limit=f"{most} bytes", got=f"{made}")


def _run_bytes(segment: bytes) -> int:
    place = made = 0
    while place < len(segment):
        head = segment[place]
        if head < 128:  # this many bytes plus one follow literally
            made += head + 1
            place += head + 2
        else:  # repeat the next byte; 128 is a no-op
            made += 257 - head if head > 128 else 0
            place += 2 if head > 128 else 1
    return made
