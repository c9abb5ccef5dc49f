"""Names from outside (files, series, patients, trajectories, devices) cannot steer a terminal or flood it."""

from __future__ import annotations

import re

LONGEST_WORD = 160  # characters: a path or a number stays within a line of a wide terminal
LONGEST_LINE = 4000  # an error that lists what is wrong in a file is a paragraph, not a page
GAP = "…"

_LONG_WORD = re.compile(rf"\S{{{LONGEST_WORD + 1},}}")


def printable(text: str) -> str:
    """One line of it, without control characters, whose words and numbers have an end.

    What is too long is shortened in its middle: a path is known by its beginning and its end.
    """
    line = without_controls(text)
    if len(line) <= LONGEST_WORD:
        return line
    return _shortened(_LONG_WORD.sub(lambda word: _shortened(word[0], LONGEST_WORD), line), LONGEST_LINE)


def printable_lines(text: str) -> str:
    """The same for text that may have several lines."""
    return "\n".join(map(printable, text.split("\n")))


def without_controls(text: str) -> str:
    """White space as blanks; escapes, marks that turn the direction and the like as `\\x1b`, `\\u202e`."""
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
