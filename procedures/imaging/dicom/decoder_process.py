"""Decoder subprocess for compressed slices: `python -P -m procedures.imaging.dicom.decoder_process FD`.

The decoders are C++, and damaged frames make some of them abort the whole program. Each line on standard
input names one file, or with a second argument `jpeg-ls` the length of a frame that follows; the answer on FD
is a line of JSON followed by the pixels. Ends at end of input.
"""

from __future__ import annotations

import json
import os
import resource
import signal
import sys
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

MEMORY_BYTES = 300 << 20  # beyond what the libraries use; the largest slice takes eight
SLICE_S = 5  # of processor time; a large slice takes a tenth of one


def main(arguments: list[str]) -> int:
    """Serve requests until end of input."""
    decode = _load_jpeg_ls() if arguments[1:] else _load_pydicom()  # before memory is bounded
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    bound = pages * resource.getpagesize() + MEMORY_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (bound, bound))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")  # nobody reads them here; actual errors are in the answer
    with os.fdopen(int(arguments[0]), "wb") as answers:
        for line in sys.stdin.buffer:
            # Ends the process. RLIMIT_CPU counts ticks since its start, which run ahead of its own clock on a
            # busy computer: a long series came to an end with no slice near the limit.
            signal.setitimer(signal.ITIMER_PROF, SLICE_S)
            try:
                header, pixels = decode(json.loads(line))
            except Exception as problem:  # decoders raise anything on foreign bytes: the answer says what
                _answer(answers, {"problem": (str(problem) or repr(problem))[:500]})
            else:
                _answer(answers, header, pixels)
    return 0


Decoded = tuple[dict[str, object], bytes | bytearray | memoryview]


def _load_jpeg_ls() -> Callable[[int], Decoded]:
    """Load the decoder of frames alone, for which pydicom with its 0.3 s of imports is not needed."""
    from jpeg_ls import decode_pixel_data

    def decode(count: int) -> Decoded:
        pixels, _ = decode_pixel_data(sys.stdin.buffer.read(count))
        return {"type": "|u1", "shape": [len(pixels)]}, pixels

    return decode


def _load_pydicom() -> Callable[[str], Decoded]:
    """Load the decoders of whole files in any syntax."""
    import numpy as np
    import pydicom.pixels  # noqa: F401 - loads the decoders before memory is bounded

    from procedures.imaging.dicom.attributes import read_dicom

    def decode(path: str) -> Decoded:
        stored = np.ascontiguousarray(read_dicom(Path(path)).pixel_array)
        return {"type": stored.dtype.str, "shape": stored.shape}, stored.data.cast("B")

    return decode


def _answer(
    answers: BinaryIO, header: dict[str, object], pixels: bytes | bytearray | memoryview = b""
) -> None:
    answers.write(json.dumps(header).encode() + b"\n")
    answers.write(pixels)
    answers.flush()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
