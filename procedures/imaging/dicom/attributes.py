"""Attributes of DICOM files, validated as they are read; errors name the file."""

from __future__ import annotations

import math
import warnings
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from procedures.imaging.dicom.bounded_stream import (
    DEFLATED,
    EXPLICIT,
    LONGEST_VALUE,
    BoundedStream,
    DataSetDeflated,
)
from procedures.imaging.errors import AttributeMissing, FileDamaged
from ronna_hw.bounded_input import InputRefused, inflate, read_bounded

LONGEST_SHOWN = 80  # characters of a value that is not as it should be
LARGEST_SLICE_BYTES = 20_000_000  # 2048 x 2048 pixels, with room for other scanner data

if TYPE_CHECKING:
    from pydicom.dataset import Dataset, FileDataset


def read_dicom(path: Path, *, only: tuple[str, ...] | None = None) -> FileDataset:
    """One file as a data set; with `only`, just those attributes, no pixels. Raises
    CT-005, naming the file.
    """
    import pydicom

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # oddities in attributes that are not used
            content = read_bounded(path, LARGEST_SLICE_BYTES)
            longest = LARGEST_SLICE_BYTES if only is None else LONGEST_VALUE
            read = partial(
                pydicom.dcmread,
                stop_before_pixels=only is not None,
                specific_tags=None if only is None else list(only),
            )
            try:
                found = read(BoundedStream(content, longest))
            except DataSetDeflated as deflated:
                found = read(BoundedStream(_inflated(content, deflated.begin), longest))
            if only is not None:
                found.buffer = None  # the whole file, of each of a thousand slices
            return found
    except InputRefused as problem:
        raise FileDamaged(f"{path.name} is refused: {problem.summary}") from problem
    except OSError as problem:
        if problem.errno is None:
            raise FileDamaged(f"{path.name} cannot be read as DICOM ({problem})") from problem
        raise
    except MemoryError:  # which says nothing about the file
        raise
    except Exception as problem:  # a damaged file can break the parser in any way
        raise FileDamaged(f"{path.name} cannot be read as DICOM ({problem})") from problem


def _inflated(content: bytes, begin: int) -> bytes:
    """The same file with its data set inflated; pydicom would do that without a size limit."""
    head = content[:begin].replace(DEFLATED, EXPLICIT)
    return head + inflate(content[begin:], LARGEST_SLICE_BYTES, raw=True)


def value(path: Path, header: Dataset, keyword: str) -> Any:
    """The decoded value; pydicom decodes lazily, so a bad value fails here."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the caller checks what matters about the value
            return header.get(keyword)
    except MemoryError:
        raise
    except Exception as problem:  # a damaged value can break the decoder in any way
        raise AttributeMissing(f"{path.name}: {keyword} is unreadable") from problem


def numbers(path: Path, header: FileDataset, keyword: str, count: int) -> tuple[float, ...]:
    stated = value(path, header, keyword)
    try:
        found = tuple(float(item) for item in ([stated] if count == 1 else stated))
    except (TypeError, ValueError):
        found = ()
    if len(found) != count or not all(math.isfinite(number) for number in found):
        expected = "a finite number" if count == 1 else f"{count} finite numbers"
        if stated is None or stated == "":
            raise AttributeMissing(f"{path.name}: {keyword} is missing", expected=expected)
        raise AttributeMissing(
            f"{path.name}: {keyword} is unusable",
            expected=expected,
            got=str(stated)[:LONGEST_SHOWN],
            action="Correct it where the series was made, and export it again.",
        )
    return found


def optional_number(path: Path, header: FileDataset, keyword: str) -> float | None:
    return None if value(path, header, keyword) in (None, "") else numbers(path, header, keyword, 1)[0]


def text(path: Path, header: Dataset, keyword: str) -> str:
    stated = value(path, header, keyword)
    return "" if stated is None else str(stated).strip()


def required_text(path: Path, header: FileDataset, keyword: str) -> str:
    stated = text(path, header, keyword)
    if not stated:
        raise AttributeMissing(f"{path.name}: {keyword} is missing")
    return stated
