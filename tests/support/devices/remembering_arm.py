"""The errors of an arm in the poses that many trials visit, computed once."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Self

from procedures.room.model import TrackedArm
from procedures.room.sighting import Rest
from ronna_hw.arrays import Array
from ronna_hw.vectors import JointVector


@dataclass(frozen=True)
class RememberingArm(TrackedArm):
    """A tracked arm that remembers its errors: they follow from pose and place alone."""

    known: dict[tuple[JointVector, tuple[int, ...] | None, bytes], tuple[Array, Array]] = field(
        init=False, default_factory=dict, compare=False
    )

    def errors(self, rest: Rest, place_mm: Array) -> tuple[Array, Array]:
        at = (rest.joints_rad, rest.sides, place_mm.tobytes())
        if at not in self.known:
            self.known[at] = super().errors(rest, place_mm)
        return self.known[at]

    def __deepcopy__(self, _memory: dict[int, object]) -> Self:
        return self
