"""TOML of limited size, with keys of a limited number of parts and whole numbers of 64 bits.

The standard library stores every prefix of a key: its memory grows with the square of the parts.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from ronna_hw.bounded_input.files import read_bounded
from ronna_hw.bounded_input.refusal import InputRefused
from ronna_hw.errors import RonnaError

LARGEST_TOML_BYTES = 300_000  # a plan with a hundred trajectories has twenty thousand
WHOLE = range(-(2**63), 2**63)  # as TOML requires; a long hexadecimal number cannot even be printed
MOST_VALUES = 30_000  # a plan with all the points that it may have has twelve thousand
DEEPEST = 32  # nested tables and parts of a key; more parts than a DICOM identifier can have

_PART = r"(?:[A-Za-z0-9_-]++|\"(?:[^\"\\\n]|\\.)*+\"|'[^'\n]*+')"
# Not from an escaped quote: a string without an end would be scanned from each quote in it.
_LONG_KEY = re.compile(rf"(?<![A-Za-z0-9_\-\\]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST}}}")

LONGEST_SHOWN = 80  # characters of a line with a mistake
_LINE_NUMBER = re.compile(r"\(at line (\d+), column \d+\)")
_DECIMAL_COMMA = re.compile(r"=\s*[-+]?\d+,\d+\s*(#.*)?$")
_LIKE_A_DATE = re.compile(r"=\s*\d{1,2}[./]\d{1,2}[./]\d{4}")


def read_toml(path: Path, refusal: Callable[[str], RonnaError]) -> dict[str, Any]:
    """The content of a file; raises `refusal` with the reason if it is not TOML within limits, OSError."""
    try:
        content = read_bounded(path, LARGEST_TOML_BYTES)
    except InputRefused as error:
        raise refusal(f"{path.name} is refused: {error.summary}") from error
    return toml_of(content, path.name, refusal)


def toml_of(content: bytes, name: str, refusal: Callable[[str], RonnaError]) -> dict[str, Any]:
    """The content of the bytes of a file with this name; raises `refusal` like `read_toml`."""
    try:
        return parse_toml(content.decode("utf-8-sig"))
    except InputRefused as error:
        raise refusal(f"{name} is refused: {error.summary}") from error
    except UnicodeDecodeError as error:
        raise refusal(f"{name} is not TOML: it is not UTF-8 text") from error
    except ValueError as error:
        raise refusal(f"{name} is not TOML: {error}{_line_of(error, content)}") from error


def _line_of(error: ValueError, content: bytes) -> str:
    """The line that failed to parse, and how to write a date or a decimal if it looks like one."""
    found = _LINE_NUMBER.search(str(error))
    lines = content.decode("utf-8-sig").splitlines()
    if found is None or not 0 < int(found[1]) <= len(lines):
        return ""
    line = lines[int(found[1]) - 1].strip()
    written = "; a date is written 2026-12-31" if _LIKE_A_DATE.search(line) else ""
    written = "; decimals have a point, not a comma" if _DECIMAL_COMMA.search(line) else written
    return f": {line[:LONGEST_SHOWN]}{written}"


def parse_toml(text: str) -> dict[str, Any]:
    """The content of a TOML text. Raises INP-001, and ValueError for invalid TOML."""
    if len(text) > LARGEST_TOML_BYTES:
        raise InputRefused("too much TOML", limit=f"{LARGEST_TOML_BYTES} bytes")
    if sum(map(text.count, "[{,=")) > MOST_VALUES:  # a model may find several mistakes in each
        raise InputRefused("too many values in TOML", limit=str(MOST_VALUES))
    if _LONG_KEY.search(text):
        raise InputRefused("a key with too many parts", limit=str(DEEPEST))
    try:
        content = tomllib.loads(text)
    except RecursionError as error:
        raise InputRefused("TOML nested too deep", limit=f"{DEEPEST} levels") from error
    level: list[Any] = [content]
    for _ in range(DEEPEST):
        inside = [inner for outer in level for inner in _inside(outer)]
        if any(isinstance(value, int) and value not in WHOLE for value in inside):
            raise InputRefused("a whole number in TOML is too large", limit="64 bits, signed")
        level = [inner for inner in inside if isinstance(inner, dict | list)]
        if not level:
            return content
    raise InputRefused("TOML nested too deep", limit=f"{DEEPEST} levels")


def _inside(value: Any) -> Iterator[Any]:
    return iter(value.values() if isinstance(value, dict) else value)
