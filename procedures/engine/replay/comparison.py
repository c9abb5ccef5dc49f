"""A record of the run against the same result computed again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from enum import StrEnum

from ronna_hw.records import Record

MOST_DIFFERENCES = 5  # that are named
# What another processor's arithmetic may change in a number, by the unit that its field's name ends with.
# Measured on five cases recorded on one kind and computed again on another: up to 5e-6 mm and 7e-9 rad.
ROUNDING = {"_mm": 1e-5, "_rad": 1e-7, "_wxyz": 1e-7}
ROUNDING_SHARE = 1e-3  # of any other number; a covariance in those cases: 1e-4


class Verdict(StrEnum):
    """What a replay says of one record."""

    EQUAL = "equal"
    ROUNDED = "rounded"
    DIFFERENT = "different"
    NOT_RECORDED = "not recorded"


@dataclass(frozen=True)
class ReplayedRecord:
    """`why` names the fields that differ, or what kept the result from being computed."""

    record: str
    step: str
    verdict: Verdict
    why: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Difference:
    text: str
    rounding: bool = False


def compared(step: str, recorded: Record, again: Record) -> ReplayedRecord:
    """Equal only when every field of the payload is, bit for bit; rounded when numbers differ by no more than
    another processor's arithmetic explains.
    """
    found = list(_differences(recorded.payload, again.payload, ""))
    true = [one for one in found if not one.rounding]
    verdict = Verdict.DIFFERENT if true else Verdict.ROUNDED if found else Verdict.EQUAL
    why = tuple(one.text for one in (true or found)[:MOST_DIFFERENCES])
    return ReplayedRecord(recorded.identifier, step, verdict, why)


def _differences(was: object, now: object, where: str, field: str = "") -> Iterator[_Difference]:
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for name in dict.fromkeys((*was, *now)):
            inside = f"{where}.{name}" if where else str(name)
            if was.get(name) is None and now.get(name) is None:
                continue  # an optional field that one of both versions did not know
            if name not in was or name not in now:
                yield _Difference(f"{inside}: {'recorded' if name in was else 'computed'} only")
            else:
                yield from _differences(was[name], now[name], inside, str(name))
    elif isinstance(was, list | tuple) and isinstance(now, list | tuple) and len(was) == len(now):
        for place, (one, other) in enumerate(zip(was, now, strict=True)):
            yield from _differences(one, other, f"{where}[{place}]", field)
    elif was != now:
        rounding = isinstance(was, float) and isinstance(now, float) and _rounded(field, was, now)
        yield _Difference(f"{where}: {_short(was)} recorded, {_short(now)} computed", rounding)


def _rounded(field: str, was: float, now: float) -> bool:
    limits = [limit for unit, limit in ROUNDING.items() if field.endswith(unit)]
    return abs(was - now) <= (limits[0] if limits else ROUNDING_SHARE * max(abs(was), abs(now)))


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."
