"""DICOM file reader that validates attributes and names the file in every error.

Reads are bounded, because a damaged file can make the parser read without end.
"""

from __future__ import annotations

import io
import math
import warnings
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from procedures.imaging.errors import ATTRIBUTE_MISSING, FILE_DAMAGED
from ronna_hw.bounded_input import InputRefused, inflate, read_bounded

if TYPE_CHECKING:
    from pydicom.dataset import Dataset, FileDataset

MOST_READS = 50_000  # two to four per element; a slice has hundreds, with private sequences thousands
LONGEST_VALUE = 65_536  # of an attribute other than pixels; none in use exceeds a hundred bytes
DEFLATED = b"1.2.840.10008.1.2.1.99"  # everything after the meta header is deflated (PS3.5 A.5)
EXPLICIT = b"1.2.840.10008.1.2.1".ljust(len(DEFLATED), b"\0")  # the equivalent syntax once inflated

LONGEST_SHOWN = 80  # characters quoted of an unusable value
START_BYTES = 16_384  # enough for the attributes of most scanners; otherwise the whole file is read
LARGEST_SLICE_BYTES = 20_000_000  # 2048 x 2048 pixels, with room for other scanner data


def read_dicom(path: Path, *, only: tuple[str, ...] | None = None) -> FileDataset:
    """Read a DICOM file, or just the attributes `only`, without pixels. Raises CT-005."""
    import pydicom

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # oddities in attributes that are not used
            longest = LARGEST_SLICE_BYTES if only is None else LONGEST_VALUE
            read = partial(
                pydicom.dcmread,
                stop_before_pixels=only is not None,
                specific_tags=None if only is None else list(only),
            )
            found = None
            if only is not None:
                with suppress(Exception):  # whatever it is, the whole file shows it
                    start = read_bounded(path, LARGEST_SLICE_BYTES, start_bytes=START_BYTES)
                    found = read(BoundedStream(start, longest, is_start=len(start) == START_BYTES))
            if found is None:
                content = read_bounded(path, LARGEST_SLICE_BYTES)
                try:
                    found = read(BoundedStream(content, longest))
                except DataSetDeflated as deflated:
                    found = read(BoundedStream(_inflate(content, deflated.begin), longest))
            if only is not None:
                found.buffer = None  # the whole file, of each of a thousand slices
            return found
    except InputRefused as problem:
        raise FILE_DAMAGED(f"{path.name} is refused: {problem.summary}") from problem
    except OSError as problem:
        if problem.errno is None:
            raise FILE_DAMAGED(f"{path.name} cannot be read as DICOM ({problem})") from problem
        raise
    except MemoryError:  # which says nothing about the file
        raise
    except Exception as problem:  # a damaged file can break the parser in any way
        raise FILE_DAMAGED(f"{path.name} cannot be read as DICOM ({problem})") from problem


def _inflate(content: bytes, begin: int) -> bytes:
    """Inflate a file's data set within a size limit, which pydicom does not enforce."""
    head = content[:begin].replace(DEFLATED, EXPLICIT)
    return head + inflate(content[begin:], LARGEST_SLICE_BYTES, raw=True)


class DataSetDeflated(Exception):
    """The data set is deflated; `begin` is the position where it starts."""

    def __init__(self, begin: int) -> None:
        self.begin = begin


class StartTooShort(Exception):
    """A read extends past the part of the file that was loaded."""


class BoundedStream(io.BytesIO):
    """Byte stream that limits reads; with `is_start`, it contains only the start of the file.

    Raises INP-001 for too many reads or too long a value, DataSetDeflated on an attempt to read all the rest.
    """

    def __init__(self, content: bytes, longest_value: int, *, is_start: bool = False) -> None:
        super().__init__(content)
        self._start_bytes = len(content) if is_start else None
        self._reads_left = MOST_READS
        self._longest_value = longest_value

    def read(self, size: int | None = -1, /) -> bytes:
        """Read `size` bytes. Raises if no size is given or if the read extends past the loaded start."""
        if size is None or size < 0:
            raise StartTooShort if self._start_bytes is not None else DataSetDeflated(self.tell())
        if self._start_bytes is not None and self.tell() + size > self._start_bytes:
            raise StartTooShort
        self._reads_left -= 1
        if self._reads_left < 0:
            raise InputRefused("too many elements", limit=f"{MOST_READS} reads")
        if size > self._longest_value:
            raise InputRefused("a value is too long", limit=f"{self._longest_value} bytes", got=f"{size}")
        return super().read(size)


def read_value(path: Path, header: Dataset, keyword: str) -> Any:
    """Decode one attribute. pydicom decodes lazily, so a bad value fails only here. Raises CT-012."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the caller checks what matters about the value
            return header.get(keyword)
    except MemoryError:
        raise
    except Exception as problem:  # a damaged value can break the decoder in any way
        raise ATTRIBUTE_MISSING(f"{path.name}: {keyword} is unreadable") from problem


def read_numbers(path: Path, header: FileDataset, keyword: str, count: int) -> tuple[float, ...]:
    raw_value = read_value(path, header, keyword)
    try:
        found = tuple(float(item) for item in ([raw_value] if count == 1 else raw_value))
    except (TypeError, ValueError):
        found = ()
    if len(found) != count or not all(math.isfinite(number) for number in found):
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        if raw_value is None or raw_value == "":
            raise ATTRIBUTE_MISSING(f"{path.name}: {keyword} is missing", expected=expected)
        raise ATTRIBUTE_MISSING(
            f"{path.name}: {keyword} is unusable",
            expected=expected,
            got=str(raw_value)[:LONGEST_SHOWN],
            action="Correct it where the series was made, and export it again.",
        )
    return found


def read_optional_number(path: Path, header: FileDataset, keyword: str) -> float | None:
    if read_value(path, header, keyword) in (None, ""):
        return None
    return read_numbers(path, header, keyword, 1)[0]


def read_attribute_text(path: Path, header: Dataset, keyword: str) -> str:
    raw_value = read_value(path, header, keyword)
    return "" if raw_value is None else str(raw_value).strip()


def require_text(path: Path, header: FileDataset, keyword: str) -> str:
    raw_value = read_attribute_text(path, header, keyword)
    if not raw_value:
        raise ATTRIBUTE_MISSING(f"{path.name}: {keyword} is missing")
    return raw_value
