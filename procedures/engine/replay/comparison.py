"""A record of the run against the same result computed again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum
from itertools import islice

from ronna_hw.records import Record

MOST_DIFFERENCES = 5  # that are named


class Verdict(StrEnum):
    """What a replay says of one record."""

    EQUAL = "equal"
    DIFFERENT = "different"
    NOT_RECORDED = "not recorded"


@dataclass(frozen=True)
class ReplayedRecord:
    """`why` names the fields that differ, or what kept the result from being computed."""

    record: str
    step: str
    verdict: Verdict
    why: tuple[str, ...] = ()


def compared(step: str, recorded: Record, again: Record) -> ReplayedRecord:
    """Equal only when every field of the payload is, bit for bit."""
    found = tuple(islice(_differences(recorded.payload, again.payload, ""), MOST_DIFFERENCES))
    verdict = Verdict.DIFFERENT if found else Verdict.EQUAL
    return ReplayedRecord(recorded.identifier, step, verdict, found)


def _differences(was: object, now: object, where: str) -> Iterator[str]:
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for name in dict.fromkeys((*was, *now)):
            inside = f"{where}.{name}" if where else str(name)
            if name not in was or name not in now:
                yield f"{inside}: {'recorded' if name in was else 'computed'} only"
            else:
                yield from _differences(was[name], now[name], inside)
    elif isinstance(was, list | tuple) and isinstance(now, list | tuple) and len(was) == len(now):
        for place, (one, other) in enumerate(zip(was, now, strict=True)):
            yield from _differences(one, other, f"{where}[{place}]")
    elif was != now:
        yield f"{where}: {_short(was)} recorded, {_short(now)} computed"


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
