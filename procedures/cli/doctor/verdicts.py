"""One word for each device and one for the case: can it start, and what prevents it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from procedures.cli.doctor.theatre_checks import NEEDED
from ronna_hw.devices.probing import Diagnostic

CASE = "case"


@dataclass(frozen=True)
class Verdict:
    """`because` names what was looked at and found wrong, in the order in which it is shown."""

    of: str
    ready: bool
    because: tuple[str, ...]


def verdicts(case: Sequence[Diagnostic], devices: Mapping[str, Sequence[Diagnostic]]) -> Iterator[Verdict]:
    """Of each device by its table in the theatre file, then of the case, which needs only some of them."""
    for name, found in devices.items():
        yield _verdict(name, found)
    needed = [one for name in NEEDED for one in devices.get(name, ())]
    yield _verdict(CASE, [*case, *needed])


def _verdict(of: str, found: Sequence[Diagnostic]) -> Verdict:
    because = tuple(f"{one.subject.removeprefix(f'{of}: ')}: {one.seen}" for one in found if not one.well)
    return Verdict(of, not because, because)
