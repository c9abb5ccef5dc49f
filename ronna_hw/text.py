"""Text formatting for display (safe names, counts, values next to limits) and parsing of typed numbers.

Names of files, series, patients and devices must neither steer nor flood a terminal.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

LONGEST_WORD = 160  # characters: a path or a number fits on a line of a wide terminal
LONGEST_LINE = 4000  # an error that lists the mistakes in a file is a paragraph, not a page
GAP = "…"
_LONG_WORD = re.compile(rf"\S{{{LONGEST_WORD + 1},}}")


def printable(text: str) -> str:
    """Return text as one line without control characters, limiting the length of words and numbers.

    Anything too long is shortened in the middle: a path is recognised by its beginning and end.
    """
    line = escape_controls(text)
    if len(line) <= LONGEST_WORD:
        return line
    return _shorten(_LONG_WORD.sub(lambda word: _shorten(word[0], LONGEST_WORD), line), LONGEST_LINE)


def printable_lines(text: str) -> str:
    """Make each line of a text printable."""
    return "\n".join(map(printable, text.split("\n")))


def escape_controls(text: str) -> str:
    """Replace whitespace with spaces, and other unprintable characters with backslash escapes."""
    return text if text.isprintable() else "".join(map(_escape_character, text))


def _escape_character(letter: str) -> str:
    if letter.isprintable():
        return letter
    return " " if letter.isspace() else letter.encode("unicode_escape").decode("ascii")


def _shorten(text: str, most: int) -> str:
    if len(text) <= most:
        return text
    end = (most - len(GAP)) // 2
    return f"{text[: most - len(GAP) - end]}{GAP}{text[-end:]}"


MOST_SHOWN = 5  # of a list of names


def format_count(number: int, one: str, several: str | None = None) -> str:
    """Format a count with its noun: `1 mistake`, `2 mistakes`; `several` is an irregular plural."""
    return f"{number} {one if number == 1 else several or one + 's'}"


def format_names(names: Sequence[str]) -> str:
    """List the first few names and count the rest: `a, b and 4 more`."""
    listed = ", ".join(names[:MOST_SHOWN])
    return listed if len(names) <= MOST_SHOWN else f"{listed} and {len(names) - MOST_SHOWN} more"


MOST_MORE = 6  # decimals; a value still indistinguishable from the limit equals it


def format_against_limit(value: float, limit: float, decimals: int) -> str:
    """Format a value with enough decimals to show which side of a fully printed limit it is on.

    `format_against_limit(0.1504, 0.15, 2)` is `0.1504`: "limit 0.15 mm, got 0.15 mm" would say nothing.
    """
    for extra_decimals in range(MOST_MORE):
        shown = round(value, decimals + extra_decimals)
        if (shown > limit) == (value > limit) and shown != limit:
            return f"{value:.{decimals + extra_decimals}f}"
    return f"{value:.{decimals}f}"


def format_distinct(value: float, limit: float, decimals: int) -> tuple[str, str]:
    """Format a value and a computed limit with enough decimals to distinguish them."""
    for extra_decimals in range(MOST_MORE):
        shown, refused_from = (f"{one:.{decimals + extra_decimals}f}" for one in (value, limit))
        if shown != refused_from:
            return shown, refused_from
    return f"{value:.{decimals}f}", f"{limit:.{decimals}f}"


_NUMBER = re.compile(r"[+-]?(\d+([.,]\d*)?|[.,]\d+)", re.ASCII)


def parse_typed_number(typed: str, unit: str = "") -> float:
    """Parse a finite number with a decimal point or comma; raises ValueError quoting the text.

    The `unit` may follow it, with or without a space; another unit may not.
    """
    words = strip_unit(typed, unit).replace("\N{MINUS SIGN}", "-")
    number = float(words.replace(",", ".")) if _NUMBER.fullmatch(words) else math.nan
    if not math.isfinite(number):
        raise ValueError(repr(typed.strip()))
    return number


UNITS = {  # by the end of the name of a field or an option, the longer ends first
    "mm_s": "mm/s",
    "deg_s": "deg/s",
    "mm2": "mm2",
    "mm": "mm",
    "um": "um",
    "deg": "deg",
    "rad": "rad",
    "ms": "ms",
    "s": "s",
    "hz": "Hz",
    "n": "N",
    "kg": "kg",
    "px": "px",
    "days": "days",
    "bytes": "bytes",
}


def unit_of(name: str) -> str:
    """Return the unit that the name of a field, an option or a metavariable ends with, or an empty string."""
    words = name.strip("-").casefold().replace("-", "_").replace("/", "_")
    return next((unit for end, unit in UNITS.items() if words == end or words.endswith(f"_{end}")), "")


def strip_unit(typed: str, unit: str) -> str:
    """Strip surrounding space and a trailing unit from typed text."""
    words = typed.strip()
    return words[: -len(unit)].rstrip() if unit and words.casefold().endswith(unit.casefold()) else words
