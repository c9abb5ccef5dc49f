"""Where an arm is, and whether an instrument may be inside: the one answer for engine, steps and recovery."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from procedures.workcell.insertion import Insertion


class Where(StrEnum):
    """The place of an arm, as far as the journal says."""

    HOME = "home"
    AWAY = "away from home"
    ON_AXIS = "on the axis of a trajectory"
    MOVING = "moving"
    UNKNOWN = "not known"


@dataclass(frozen=True)
class ArmPlace:
    """The place of one arm, folded from the journal: see `ArmHistory`.

    `axis` is set from the intent to insert the guide to the end of its withdrawal, also while it moves there
    or a kill leaves open where it stopped. `instrument_may_be_inside` names a trajectory, the gauge or the
    divot; `assumed` says that no line of the journal has put it there.
    """

    where: Where = Where.UNKNOWN
    axis: Insertion | None = None
    withdrawn_from: str | None = None  # the trajectory from which the guide came last, if it is on none
    instrument_may_be_inside: str | None = None
    assumed: bool = False
    moved: bool = False  # by a motion of this run

    @property
    def is_home(self) -> bool:
        """Whether the arm stands at home."""
        return self.where is Where.HOME

    @property
    def is_out(self) -> bool:
        """Whether the arm may be away from its home, by a motion of the run or as it was measured."""
        return not self.is_home and (self.moved or self.where is not Where.UNKNOWN)

    @property
    def trajectory(self) -> str | None:
        """The trajectory on whose axis the guide is, or may be."""
        return None if self.axis is None else self.axis.trajectory

    @property
    def on_axis(self) -> bool:
        """Whether the guide is, or may be, on the axis of a trajectory."""
        return self.axis is not None

    @property
    def why_held(self) -> tuple[str, ...]:
        """The reason why nothing but a retreat is possible, while the guide is on an axis."""
        if self.trajectory is None:
            return ()
        return (f"the guide is held in front of the entry of {self.trajectory}",)

    @property
    def instrument_in_words(self) -> str | None:
        """The instrument that is or may be inside, in words."""
        if (inside := self.instrument_may_be_inside) is None:
            return None
        return f"an instrument {'may still be' if self.assumed else 'is still'} in {inside}"
