"""JSON with a limited number of values, limited depth, and finite numbers.

The limits are checked on the text: a parsed document is up to thirty times as large.
"""

from __future__ import annotations

import json
import math
import re
from pathlib import Path
from typing import Any

from ronna_hw.bounded_input.files import read_bounded
from ronna_hw.bounded_input.refusal import InputRefused

LARGEST_JSON_BYTES = 100_000_000  # a case's journal has a hundredth of it
MOST_VALUES = 2_000_000  # up to 120 bytes each in memory
MOST_VALUES_OF_A_MODEL = 100_000  # two are an empty object, whose missing fields take four kilobytes
MOST_VALUES_OF_LINES = 2_000_000  # of which a case's tape of readings has a tenth
DEEPEST = 64  # records nest about ten deep
MOST_DIGITS = 20  # of an integer: nanoseconds since 1970 have 19

# An escaped quote begins no string; if it could, one without an end would be scanned from each quote in it.
_STRING = re.compile(rb'(?<!\\)"(?:[^"\\]|\\.)*+"', re.DOTALL)
_NO_BRACKETS = re.compile(rb"[^\[\]{}]+")


def parse_json(text: bytes | str, limit_bytes: int = LARGEST_JSON_BYTES) -> Any:
    """The value of a JSON text. Raises INP-001, and ValueError for invalid JSON."""
    content = check_json(text.encode() if isinstance(text, str) else text, limit_bytes, MOST_VALUES)
    if b"\0" in content:  # as in every other encoding, whose depth is not seen
        raise ValueError("JSON that is not UTF-8")
    try:
        return json.loads(content, parse_int=_whole, parse_float=_finite, parse_constant=_finite)
    except RecursionError as error:  # from brackets that never close
        raise InputRefused("JSON nested too deep", limit=f"{DEEPEST} levels") from error


def read_json_bytes(
    path: Path,
    limit_bytes: int = LARGEST_JSON_BYTES,
    most_values: int = MOST_VALUES_OF_A_MODEL,
    *,
    linked: bool = True,
) -> bytes:
    """A JSON file as bytes for a model to validate; `linked` as in `read_bounded`. Raises
    INP-001, OSError.
    """
    return check_json(read_bounded(path, limit_bytes, linked=linked), limit_bytes, most_values)


def read_json_lines(path: Path, limit_bytes: int = LARGEST_JSON_BYTES, *, linked: bool = True) -> bytes:
    """A file of JSON lines, the last of which may be torn; `linked` likewise. Raises INP-001, OSError."""
    return _check_count(read_bounded(path, limit_bytes, linked=linked), MOST_VALUES_OF_LINES)


def check_json(
    content: bytes, limit_bytes: int = LARGEST_JSON_BYTES, most_values: int = MOST_VALUES_OF_A_MODEL
) -> bytes:
    """The same bytes if they are within limits; raises INP-001. Numbers in them may be anything."""
    if len(content) > limit_bytes:
        raise InputRefused("the JSON is too large", limit=f"{limit_bytes} bytes", got=f"{len(content)}")
    _check_count(content, most_values)
    if content.count(b"[") + content.count(b"{") > DEEPEST and _deeper_than_allowed(content):
        raise InputRefused("JSON nested too deep", limit=f"{DEEPEST} levels")
    return content


def _check_count(content: bytes, most_values: int) -> bytes:
    if values_in(content) > most_values:
        raise InputRefused("too many values in JSON", limit=str(most_values))
    return content


def values_in(content: bytes) -> int:
    """At most so many values are in a JSON text."""
    return sum(content.count(mark) for mark in (b"[", b"{", b",", b":"))


def _deeper_than_allowed(content: bytes) -> bool:
    """Whether brackets remain after removing the innermost ones once per level."""
    brackets = _NO_BRACKETS.sub(b"", _STRING.sub(b"", content))
    for _ in range(DEEPEST):
        if not brackets:
            return False
        brackets = brackets.replace(b"[]", b"").replace(b"{}", b"")
    return bool(brackets)


def _whole(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise InputRefused("a whole number in JSON has too many digits", limit=f"{MOST_DIGITS} digits")
    return int(digits)


def _finite(number: str) -> float:
    """Parse a fraction; rejects NaN and Infinity, which are not JSON."""
    value = float(number)
    if not math.isfinite(value):
        raise InputRefused("a number in JSON that is not finite", got=number[:MOST_DIGITS])
    return value
