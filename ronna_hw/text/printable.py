"""Keeps names from outside (files, series, patients, devices) from steering or flooding a terminal."""

from __future__ import annotations

import re

LONGEST_WORD = 160  # characters: a path or a number fits on a line of a wide terminal
LONGEST_LINE = 4000  # an error that lists the mistakes in a file is a paragraph, not a page
GAP = "…"

_LONG_WORD = re.compile(rf"\S{{{LONGEST_WORD + 1},}}")


def printable(text: str) -> str:
    """The text as one line, without control characters, with words and numbers of limited length.

    Anything too long is shortened in the middle: a path is recognised by its beginning and end.
    """
    line = without_controls(text)
    if len(line) <= LONGEST_WORD:
        return line
    return _shortened(_LONG_WORD.sub(lambda word: _shortened(word[0], LONGEST_WORD), line), LONGEST_LINE)


def printable_lines(text: str) -> str:
    """The same for text that may have several lines."""
    return "\n".join(map(printable, text.split("\n")))


def without_controls(text: str) -> str:
    """White space as blanks; escapes, direction marks and the like as `\\x1b`, `\\u202e`."""
    if text.isprintable():
        return text
    return "".join(map(_shown, text))


def _shown(letter: str) -> str:
    if letter.isprintable():
        return letter
    if letter.isspace():
        return " "
    return letter.encode("unicode_escape").decode("ascii")


def _shortened(text: str, most: int) -> str:
    if len(text) <= most:
        return text
    end = (most - len(GAP)) // 2
    return f"{text[: most - len(GAP) - end]}{GAP}{text[-end:]}"
