"""Suggests what an invalid line was probably meant to say, as a valid line."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from difflib import get_close_matches

from sim.world.faults.kinds import TERMINALS, FaultKind

LONGEST_COMPARED = 200  # characters of a line
MOST_TRIED = 4  # similar lines: each is parsed
LEAST_ALIKE = 0.6  # similarity between a line and its suggestion; below this, an example is more helpful
_ARGUMENT = re.compile(r"[+-]?[0-9]+([.][0-9]+)?|[A-Za-z0-9_][A-Za-z0-9_.-]*")
_TRIGGER = re.compile(r"\s*(at|when|since|now)\b[^:]*(:[A-Za-z0-9_.-]+)?:")  # a step may name its trajectory


def nearest_kind(line: str, kinds: Sequence[FaultKind]) -> FaultKind | None:
    """The kind whose phrase is most similar to the line after its beginning; None if none is close."""
    by_usage = {kind.usage: kind for kind in kinds}
    return next((by_usage[usage] for usage in _nearest(_said(line), [*by_usage], 1)), None)


def meant(line: str, kinds: Sequence[FaultKind], reads: Callable[[str], bool]) -> str | None:
    """What was probably meant, with the line's numbers and names; None if nothing is close enough."""
    begins, says = line[: len(line) - len(_said(line))], _said(line)
    phrase, lasts, duration = says.partition(" for ")
    filled = [one for kind in kinds for one in _filled(kind, phrase.split())]
    for nearest in _nearest(phrase, filled, MOST_TRIED):
        whole = f"{begins}{nearest}{lasts}{duration}".strip()
        if reads(whole):
            return whole
    return None


def _said(line: str) -> str:
    """Without its beginning, if it has one."""
    found = _TRIGGER.match(line)
    return line[found.end() :].lstrip() if found else line


def _filled(kind: FaultKind, words: Sequence[str]) -> Iterator[str]:
    """A kind's phrase with the arguments found at their places in the line."""
    phrase = [kind.device, *kind.phrase.split()]
    for said in (words, [kind.device, *words]):  # the device is easily forgotten
        if len(said) in (len(phrase), len(phrase) - 1):  # so is the unit at the end
            pairs = zip(phrase, [*said, ""], strict=False)
            filled = [word if known in TERMINALS else known for known, word in pairs]
            arguments = [word for known, word in zip(phrase, filled, strict=True) if known in TERMINALS]
            known_one = not (arguments and kind.choices) or arguments[0] in kind.choices
            if all(filled) and known_one and all(map(_ARGUMENT.fullmatch, arguments)):
                yield " ".join(filled)


def _nearest(says: str, known: Sequence[str], count: int) -> list[str]:
    return get_close_matches(says[:LONGEST_COMPARED], known, count, LEAST_ALIKE)
