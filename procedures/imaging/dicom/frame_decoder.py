"""Decodes compressed slices in a process of its own, so that a crashing decoder does not end the case."""

from __future__ import annotations

import contextlib
import json
import math
import os
import select
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from ronna_hw.host.process import children_uninterrupted, describe_exit

PROCESS = "procedures.imaging.dicom.decoder_process"
LIMIT_S = (
    30.0  # host time for one slice, the first with the imports; its processor time has a limit of its own
)
END_LIMIT_S = 1.0  # for a decoder that has stopped answering
PIPE_BYTES = 1 << 16


class NotDecoded(Exception):
    """Carries the decoder's message, or how its process ended."""


class FrameDecoder:
    """Decoder for one series; its process starts with the first slice that needs it."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._answers = -1
        self._buffer = bytearray()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def decode(self, path: Path) -> NDArray[Any]:
        """The stored values of a slice. Raises NotDecoded."""
        process = self._started()
        assert process.stdin is not None, "it was started with one"
        deadline_s = time.monotonic() + LIMIT_S
        try:
            process.stdin.write(json.dumps(str(path)).encode() + b"\n")
            process.stdin.flush()
            header = json.loads(self._line(deadline_s))
            if "problem" in header:
                raise NotDecoded(header["problem"])
            kind, shape = np.dtype(header["type"]), tuple(header["shape"])
            pixels = self._bytes(kind.itemsize * math.prod(shape), deadline_s)
        except (OSError, EOFError, ValueError) as problem:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_LIMIT_S)
            ended = "no answer" if process.returncode is None else describe_exit(process.returncode)
            self.close()
            raise NotDecoded(f"its decoder gave up: {ended}") from problem
        return np.frombuffer(pixels, kind).reshape(shape)

    def _started(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            self._answers, theirs = os.pipe()
            self._buffer.clear()
            try:
                with children_uninterrupted():
                    self._process = subprocess.Popen(
                        [sys.executable, "-P", "-m", PROCESS, str(theirs)],
                        stdin=subprocess.PIPE,
                        stdout=subprocess.DEVNULL,
                        stderr=subprocess.DEVNULL,  # decoders report damaged frames there
                        pass_fds=(theirs,),
                        start_new_session=True,
                    )
            finally:
                os.close(theirs)
        return self._process

    def _line(self, deadline_s: float) -> bytes:
        while b"\n" not in self._buffer:
            self._read(deadline_s)
        line, _, self._buffer = self._buffer.partition(b"\n")
        return bytes(line)

    def _bytes(self, count: int, deadline_s: float) -> bytes:
        while len(self._buffer) < count:
            self._read(deadline_s)
        taken, self._buffer = bytes(self._buffer[:count]), self._buffer[count:]
        return taken

    def _read(self, deadline_s: float) -> None:
        if not select.select([self._answers], [], [], max(0.0, deadline_s - time.monotonic()))[0]:
            raise TimeoutError
        part = os.read(self._answers, PIPE_BYTES)
        if not part:
            raise EOFError
        self._buffer += part

    def close(self) -> None:
        """End its process; the next slice starts another."""
        if self._process is None:
            return
        with contextlib.suppress(OSError):
            if self._process.stdin is not None:
                self._process.stdin.close()
        self._process.kill()
        self._process.wait()
        os.close(self._answers)
        self._process = None
