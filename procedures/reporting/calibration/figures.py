"""What the figures of every calibration have in common: plain numbers, and a table with their spread."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from typing import Any, NamedTuple

from pydantic import BaseModel, ConfigDict

from procedures.reporting.numbers import millimetres
from ronna_hw.calibration import Numbers3

AXES = ("x", "y", "z")
Matrix3 = tuple[Numbers3, Numbers3, Numbers3]


class Figure(NamedTuple):
    """One line of the table; `spread` is the standard error, in the unit of the value."""

    name: str
    value: str
    spread: str = ""
    verdict: str = ""


class Numbers(BaseModel):
    """Numbers of a result; its fields are the keys of `--json`, in their order."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False, from_attributes=True)


class Figures(Numbers, ABC):
    """All figures of one result."""

    def as_json(self) -> dict[str, Any]:
        """What `--json` prints."""
        return self.model_dump(mode="json")

    @abstractmethod
    def table(self) -> Iterator[Figure]:
        """The figures that an operator reads."""


class RecordFigures(Figures):
    """Figures of a calibration that made a dated record."""

    calibration: str
    created: str
    expires: str

    @abstractmethod
    def quality(self) -> Iterator[Figure]:
        """What was measured, and how accurate the record is."""

    def table(self) -> Iterator[Figure]:
        """The quality of the record, and how long it is valid."""
        yield from self.quality()
        yield Figure("made", self.created[:16].replace("T", " "))
        yield Figure("valid until", self.expires[:16].replace("T", " "))

    def warnings(self) -> Iterator[str]:
        """What the operator should know before using the record."""
        yield from ()


def expected_mm(value_mm: float, predicted_mm: float) -> str:
    """An rms error in millimetres next to the one that was predicted."""
    return f"{millimetres(value_mm)}, expected {millimetres(predicted_mm)}"
