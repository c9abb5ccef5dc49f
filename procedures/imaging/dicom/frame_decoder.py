"""Decoding of compressed slices in a separate process, so that a decoder crash does not end the case.

The size that a frame declares is checked first: decoders allocate whatever it declares, and one of them
aborts the whole program if that is too much.
"""

from __future__ import annotations

import contextlib
import fcntl
import json
import math
import os
import select
import signal
import struct
import subprocess
import sys
import time
import warnings
from itertools import pairwise
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ronna_hw.bounded_input import InputRefused
from ronna_hw.host.process import describe_exit, shield_children

PROCESS = "procedures.imaging.dicom.decoder_process"
LIMIT_S = 30.0  # host time for one slice, the first with the imports; processor time has its own limit
END_LIMIT_S = 1.0  # for a decoder that has stopped answering
HEADER_BYTES = 128  # the first line of an answer and little more: the pixels are read where they remain
PIPE_BYTES = 1 << 20  # what Linux grants by default: a slice in one piece

JPEG_LS = "1.2.840.10008.1.2.4.80"  # lossless
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


class NotDecoded(Exception):
    """A slice could not be decoded; the message is the decoder's, or says how its process ended.

    `from_outside`: the process was killed or halted by somebody else, so the slice may be sound.
    """

    def __init__(self, problem: str, *, from_outside: bool = False) -> None:
        super().__init__(problem)
        self.from_outside = from_outside


class FrameDecoder:
    """Decoder for one series. Its process starts with the first compressed slice."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._is_for_frames = False
        self._answers = -1
        self._deadline_s = 0.0  # host time
        self._buffer = bytearray()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def decode(self, path: Path) -> NDArray[Any]:
        """Return the stored values of a slice. Raises NotDecoded."""
        self._send(json.dumps(str(path)).encode() + b"\n", is_frame=False)
        return self.receive()

    def send_jpeg_ls(self, frame: bytes) -> None:
        """Have a JPEG-LS frame decoded; `receive` must follow. Raises NotDecoded."""
        self._send(b"%d\n" % len(frame) + frame, is_frame=True)

    def receive(self) -> NDArray[Any]:
        """Return a slice's stored values, of a JPEG-LS frame as little-endian bytes. Raises NotDecoded."""
        try:
            header = json.loads(self._read_line())
            if "problem" in header:
                raise NotDecoded(header["problem"])
            kind, shape = np.dtype(header["type"]), tuple(header["shape"])
            pixels = self._read_bytes(kind.itemsize * math.prod(shape))
        except (OSError, EOFError, ValueError) as problem:
            raise self._give_up() from problem
        return np.frombuffer(pixels, kind).reshape(shape)

    def _send(self, request: bytes, *, is_frame: bool) -> None:
        if is_frame is not self._is_for_frames:
            self.close()
            self._is_for_frames = is_frame
        process = self._ensure_started()
        assert process.stdin is not None, "it was started with one"
        self._deadline_s = time.monotonic() + LIMIT_S
        place, rest = process.stdin.fileno(), memoryview(request)
        try:
            while rest:
                if not select.select([], [place], [], max(0.0, self._deadline_s - time.monotonic()))[1]:
                    raise TimeoutError
                rest = rest[os.write(place, rest) :]
        except OSError as problem:
            raise self._give_up() from problem

    def _give_up(self) -> NotDecoded:
        """End the process and return the error that says how it ended."""
        assert self._process is not None, "it was asked"
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(END_LIMIT_S)
        code = self._process.returncode
        self.close()
        ending = "no answer" if code is None else describe_exit(code)
        return NotDecoded(f"its decoder gave up: {ending}", from_outside=code in (None, -signal.SIGKILL))

    def _ensure_started(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            self._answers, child_end = os.pipe()
            self._buffer.clear()
            try:
                with shield_children():
                    self._process = subprocess.Popen(
                        [sys.executable, "-P", "-m", PROCESS, str(child_end)]
                        + ["jpeg-ls"] * self._is_for_frames,
                        stdin=subprocess.PIPE,
                        bufsize=0,
                        stdout=subprocess.DEVNULL,
                        stderr=subprocess.DEVNULL,  # decoders report damaged frames there
                        pass_fds=(child_end,),
                        start_new_session=True,
                    )
            finally:
                os.close(child_end)
            assert self._process.stdin is not None, "it was started with one"
            os.set_blocking(self._process.stdin.fileno(), False)  # a halted process takes nothing
            for pipe in (self._answers, self._process.stdin.fileno()):
                with contextlib.suppress(OSError):  # a user's pipes may be limited to less
                    fcntl.fcntl(pipe, fcntl.F_SETPIPE_SZ, PIPE_BYTES)
        return self._process

    def _read_line(self) -> bytes:
        while b"\n" not in self._buffer:
            self._wait()
            chunk = os.read(self._answers, HEADER_BYTES)
            if not chunk:
                raise EOFError
            self._buffer += chunk
        line, _, self._buffer = self._buffer.partition(b"\n")
        return bytes(line)

    def _read_bytes(self, count: int) -> bytearray:
        taken, self._buffer = self._buffer, bytearray()
        place = len(taken)
        taken += bytes(count - place)
        rest = memoryview(taken)
        while place < count:
            self._wait()
            got = os.readv(self._answers, [rest[place:]])
            if not got:
                raise EOFError
            place += got
        return taken

    def _wait(self) -> None:
        if not select.select([self._answers], [], [], max(0.0, self._deadline_s - time.monotonic()))[0]:
            raise TimeoutError

    def close(self) -> None:
        """End the process; the next slice starts a new one."""
        if self._process is None:
            return
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        self._process.kill()
        self._process.wait()
        os.close(self._answers)
        self._process = None


def can_decode(syntax: str) -> bool:
    """Return whether a decoder for a transfer syntax is installed."""
    from pydicom import config
    from pydicom.pixels.decoders.base import get_decoder
    from pydicom.uid import UID

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about an invalid identifier
            return bool(get_decoder(UID(syntax, validation_mode=config.IGNORE)).is_available)
    except NotImplementedError:  # raised by pydicom for a syntax that it does not know
        return False


def check_frame(syntax: str, frame: bytes, shape: tuple[int, ...], pixel_bytes: int) -> None:
    """Raise InputRefused unless the frame declares this shape (rows, columns) and one component.

    Frames of other syntaxes pass: no decoder accepts them.
    """
    try:
        if syntax == RLE:
            _check_runs(frame, shape[0] * shape[1], pixel_bytes)
        elif syntax in JPEG_2000:
            _check_size(_read_j2k_size(frame), shape)
        elif syntax in JPEG:
            _check_size(_read_jpeg_header(frame)[1:], shape)
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


def read_jpeg_bits(frame: bytes) -> int:
    """Return the bits of a sample of a frame that passed `check_frame`."""
    return _read_jpeg_header(frame)[0]


def _read_jpeg_header(frame: bytes) -> tuple[int, int, int, int]:
    """Read bits, rows, columns and components from a JPEG or JPEG-LS frame (ITU T.81 B.2.2)."""
    place = len(_START) if frame.startswith(_START) else len(frame)
    while True:
        mark, kind, length = struct.unpack_from(">BBH", frame, place)
        if mark != 0xFF or length < 2:
            raise InputRefused("a compressed frame is not JPEG")
        if kind in _SIZES:
            bits, rows, columns, components = struct.unpack_from(">BHHB", frame, place + 4)
            return bits, rows, columns, components
        place += 2 + length


def _read_j2k_size(frame: bytes) -> tuple[int, int, int]:
    """Read rows, columns and components from a JPEG 2000 code stream (ITU T.800 A.5.1)."""
    if not frame.startswith(_J2K_START):
        raise InputRefused("a compressed frame is not JPEG 2000")
    _, _, x, y, x0, y0, tile_x, tile_y, _, _, components = _J2K_SIZE.unpack_from(frame, len(_J2K_START))
    if not tile_x or not tile_y or -(-x // tile_x) * -(-y // tile_y) > MOST_TILES:
        raise InputRefused("a compressed frame has too many tiles", limit=f"{MOST_TILES} tiles")
    return y - y0, x - x0, components


def _check_runs(frame: bytes, pixels: int, pixel_bytes: int) -> None:
    """Check the segments of an RLE frame, one per byte of a pixel (PS3.5 annex G)."""
    count, *offsets = _RLE_HEADER.unpack_from(frame)
    limits = [*offsets[:pixel_bytes], len(frame)]
    if count != pixel_bytes or limits[0] < _RLE_HEADER.size or limits != sorted(limits):
        raise InputRefused("the segments of a compressed frame are not those of its pixels")
    decoded_bytes = sum(_count_run_bytes(frame[begin:end]) for begin, end in pairwise(limits))
    most = count * (pixels + RLE_SLACK_BYTES)
    if decoded_bytes > most:
        raise InputRefused(
            "a compressed frame grows too large", limit=f"{most} bytes", got=f"{decoded_bytes}"
        )


def _count_run_bytes(segment: bytes) -> int:
    place = decoded_bytes = 0
    while place < len(segment):
        head = segment[place]
        if head < 128:  # this many bytes plus one follow literally
            decoded_bytes += head + 1
            place += head + 2
        else:  # repeat the next byte; 128 is a no-op
            decoded_bytes += 257 - head if head > 128 else 0
            place += 2 if head > 128 else 1
    return decoded_bytes
