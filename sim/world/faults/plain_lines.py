"""Fault lines as scripts and control ports mostly write them, read without the grammar.

Words are separated by single blanks, and no comment follows. Every other line, right or wrong, is left to the
grammar.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from sim.world.faults.fault import TERMINALS, Fault, FaultKind
from sim.world.options import OTHER_ARMS, ArmRole

_NUMBER = r"[0-9]+(?:[.][0-9]+)?"
_BEGINNING = re.compile(rf"at ({_NUMBER}) s|at cycle ([0-9]+)|now")
_ENDING = re.compile(rf"(.+) for ({_NUMBER}) s")
_ARGUMENTS = {
    "INT": re.compile(r"[0-9]+"),
    "NUMBER": re.compile(_NUMBER),
    "SIGNED": re.compile(rf"[+-]?{_NUMBER}"),
    "NAME": re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*"),
}


def read_plain_line(line: str, number: int, kinds: Sequence[FaultKind]) -> Fault | None:
    """Return the fault in a plain line of a script, or None if it is for the grammar."""
    beginning, _, phrase = line.rstrip().partition(": ")
    begins = _BEGINNING.fullmatch(beginning)
    if begins is None:
        return None
    ends = _ENDING.fullmatch(phrase)
    words = (ends[1] if ends else phrase).split(" ")
    role = next((role for role in OTHER_ARMS if role == words[0]), ArmRole.MASTER)
    if role is not ArmRole.MASTER:
        words = words[1:]
    found = [(kind, arguments) for kind in kinds if (arguments := _arguments(kind, words)) is not None]
    if len(found) != 1:
        return None
    ((kind, arguments),) = found
    if ends and kind.momentary:
        return None
    at_cycle = begins[2] is not None
    return Fault(
        kind,
        arguments,
        float(ends[2]) if ends else 0.0 if kind.momentary else math.inf,
        at_s=None if at_cycle else float(begins[1] or "0"),
        cycle=int(begins[2]) if at_cycle else None,
        line=number,
        role=role,
    )


def _arguments(kind: FaultKind, words: Sequence[str]) -> tuple[str, ...] | None:
    expected = kind.phrase.split()
    if words[:1] != [kind.device] or len(expected) != len(words) - 1:
        return None
    arguments = []
    for known, word in zip(expected, words[1:], strict=True):
        if known in TERMINALS:
            if not _ARGUMENTS[known].fullmatch(word):
                return None
            arguments.append(word)
        elif word != known:
            return None
    return tuple(arguments)
