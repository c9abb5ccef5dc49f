"""Whether measurements belong to the theatre whose records they are to replace."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping
from datetime import datetime
from typing import Any

from pydantic import Field

from procedures.calibration.errors import OfAnotherTheatre
from ronna_hw.calibration import Dated, Strict
from ronna_hw.config import Calibrations

SAME = 1e-6  # in any unit: more than writing a number changes, far below the error of any calibration
NOT_MEASURED = {"created", "expires", "made_by"}


class Measurements(Strict, ABC):
    """What a calibration stores of what it measured."""

    created: datetime = Field(description="When it was measured.")

    @property
    @abstractmethod
    def records(self) -> Mapping[str, Dated | None]:
        """The calibration records in use, by their names in the theatre file; None if there was none."""


def require_same_theatre(
    measured: Measurements, theatre: Calibrations, found: Mapping[str, Any] | None = None
) -> None:
    """Raise CAL-020 unless each record is the theatre's, or the theatre's is what these measurements `found`.

    A calibration says where something is relative to what its records say of the rest: with another head, or
    another mount, it is wrong by their difference. Before anything is computed (`found` is None), a record
    passes that by its name may be what is found.
    """
    for name, then in measured.records.items():
        now = getattr(theatre, name)
        if now is None and then is None:
            continue
        if _alike(_content(now), _content(then)):
            continue
        if found is None:
            may_be_found = now is not None and (
                now.identifier.endswith(stamp(measured.created)) or now.identifier == _named(then)
            )
        else:
            may_be_found = _alike(_content(now), _measured(found.get(name)))
        if not may_be_found:
            raise OfAnotherTheatre(
                f"the measurements were made with another [calibration.{name}] than the theatre file's",
                expected=_named(now),
                got=_named(then) if _named(then) != _named(now) else f"{_named(then)} with other numbers",
            )


def stamp(created: datetime) -> str:
    """How the identifier of every record ends that is computed from measurements of then."""
    return f"-{created:%Y%m%dT%H%M%S}"


def _named(record: Dated | None) -> str:
    return "none" if record is None else record.identifier


def _content(record: Dated | None) -> Any:
    return None if record is None else _measured(record.model_dump())


def _measured(plain: Any) -> Any:
    return {key: value for key, value in plain.items() if key not in NOT_MEASURED} if plain else None


def _alike(one: Any, other: Any) -> bool:
    if isinstance(one, Mapping) and isinstance(other, Mapping):
        return one.keys() == other.keys() and all(_alike(one[key], other[key]) for key in one)
    if isinstance(one, list | tuple) and isinstance(other, list | tuple):
        return len(one) == len(other) and all(map(_alike, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return math.isclose(one, other, rel_tol=0.0, abs_tol=SAME)
    return bool(one == other)
