"""What a line that is no fault may have been meant to say: a line that the language reads."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from difflib import SequenceMatcher
from heapq import nlargest

from sim.theatre.faults.kinds import TERMINALS, FaultKind

LONGEST_COMPARED = 200  # characters of a line
MOST_TRIED = 4  # of the kinds that look alike: each is parsed
LEAST_ALIKE = 0.6  # of a line and what it may have meant; below, an example says more
_ARGUMENT = re.compile(r"[+-]?[0-9]+([.][0-9]+)?|[A-Za-z0-9_][A-Za-z0-9_.-]*")
_TRIGGER = re.compile(r"\s*(at|when|now)\b[^:]*(:[A-Za-z0-9_.-]+)?:")  # a step may name its trajectory


def nearest_kind(line: str, kinds: Sequence[FaultKind]) -> FaultKind:
    """The kind whose phrase is most like what the line says after its beginning."""
    return _alike(_said(line), kinds, 1)[0]


def meant(line: str, kinds: Sequence[FaultKind], reads: Callable[[str], bool]) -> str | None:
    """What was probably meant, with the numbers and names of the line; None when nothing is near enough."""
    begins, says = line[: len(line) - len(_said(line))], _said(line)
    phrase, lasts, duration = says.partition(" for ")
    for kind in _alike(phrase, kinds, MOST_TRIED):
        for filled in _filled(kind, phrase.split()):
            whole = f"{begins}{filled}{lasts}{duration}".strip()
            if _likeness(filled, phrase) >= LEAST_ALIKE and reads(whole):
                return whole
    return None


def _said(line: str) -> str:
    """Without the beginning, where there is one."""
    found = _TRIGGER.match(line)
    return line[found.end() :].lstrip() if found else line


def _filled(kind: FaultKind, words: Sequence[str]) -> Iterator[str]:
    """The phrase of a kind with the arguments that stand at their places in the line."""
    phrase = [kind.device, *kind.phrase.split()]
    for said in (words, [kind.device, *words]):  # the device is easily left out
        if len(said) in (len(phrase), len(phrase) - 1):  # so is the unit at the end
            pairs = zip(phrase, [*said, ""], strict=False)
            filled = [word if known in TERMINALS else known for known, word in pairs]
            if all(filled) and all(
                _ARGUMENT.fullmatch(word)
                for known, word in zip(phrase, filled, strict=True)
                if known in TERMINALS
            ):
                yield " ".join(filled)


def _alike(says: str, kinds: Sequence[FaultKind], count: int) -> list[FaultKind]:
    return nlargest(count, kinds, key=lambda kind: _likeness(kind.usage, says))


def _likeness(one: str, other: str) -> float:
    return SequenceMatcher(None, one, other[:LONGEST_COMPARED]).ratio()
