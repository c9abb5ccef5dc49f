"""Names of the poses of a procedure: one text for records, and one wording for people."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Self

from ronna_hw.collision_config import FIDUCIAL as FIDUCIAL_BODY

SPHERE, MARKER = "sphere", "marker"  # a fiducial, as it is called in a case and in the planner


class PoseKind(StrEnum):
    """Purpose of a pose, in the text of its name."""

    HOME = "home"
    GAUGE = "gauge"
    FIDUCIAL = "fiducial"  # one localization
    FIDUCIALS = "fiducials"  # all localizations along an axis
    TARGET = "target"


@dataclass(frozen=True)
class PoseName:
    """Name of a pose: the axis that it belongs to, if any, and its fiducial, counted from 0.

    As text, `T1/fiducial 2` or `T1/target`: records keep that.
    """

    kind: PoseKind
    trajectory: str = ""
    fiducial: int | None = None

    @classmethod
    def parse(cls, text: str) -> Self:
        """Read the text of a record. Raises ValueError."""
        trajectory, _, place = text.rpartition("/")
        kind, _, number = place.partition(" ")
        name = cls(PoseKind(kind), trajectory, int(number) if number else None)
        if str(name) != text:
            raise ValueError(f"{text!r} is no name of a pose")
        return name

    def __str__(self) -> str:
        """Return the text kept in records."""
        owner = f"{self.trajectory}/" if self.trajectory else ""
        number = "" if self.fiducial is None else f" {self.fiducial}"
        return f"{owner}{self.kind}{number}"

    def words(self, fiducial: str = SPHERE) -> str:
        """Name the pose for people, without its axis: `sphere 3`, counted from 1."""
        if self.fiducial is not None:
            return f"{fiducial} {self.fiducial + 1}"
        return f"{fiducial}s" if self.kind is PoseKind.FIDUCIALS else str(self.kind)

    def in_sentence(self, fiducial: str = SPHERE) -> str:
        """Name the pose for people within a sentence: `the target`, `sphere 3`, `home`."""
        needs_article = self.fiducial is None and self.kind is not PoseKind.HOME
        return f"the {self.words(fiducial)}" if needs_article else self.words(fiducial)


HOME, GAUGE = PoseName(PoseKind.HOME), PoseName(PoseKind.GAUGE)


def name_body(body: str) -> str:
    """Name a body of the clearance check for people: its fiducials are counted from 1 already."""
    return body.replace(FIDUCIAL_BODY, MARKER)
