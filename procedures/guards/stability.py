"""Stability of the room during a case: how each part is seen, and the smallest change noticed.

Before and after each target the arm is home, where the tracker sees everything and the arm stands as it did
before: only there is a change noticed that is small enough to matter at a target. What moves between two such
looks is found by the second, and then concerns every target worked at since the first. What neither would
notice is a share of the predicted error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from pydantic import Field

from procedures.journal.journal import Entry, Line, theatre_time_s
from procedures.journal.results import Values

if TYPE_CHECKING:
    from procedures.guards.room_watch import BaseShift

CAREFUL_FRAMES = 60  # of the tracker, at home: a second of the usual 60 Hz
# Rms of the spheres over that many frames: 0.085 mm at most in 400 simulated pairs of readings of three.
HEAD_NOTICEABLE_MM = 0.15
# The frame on the arm, home, between tracker and arm, each joint having come from the same side: noise and
# repeatability, 0.11 mm at most in 3,000 simulated pairs. From other sides, backlash makes up to 0.52 mm.
BASE_NOTICEABLE_MM = 0.15
GUIDE_NOTICEABLE_MM = 0.05  # on its gauge: one that is off by more is not the one whose tip was calibrated


class Subject(StrEnum):
    """Something that must be as it was."""

    HEAD = "head"
    BASE = "cart and tracker"
    GUIDE = "guide"
    CAMERAS = "cameras"
    INPUTS = "CT, plan and records"
    CLOCK = "clock"


@dataclass(frozen=True)
class Watched:
    """How one subject is seen, by which steps, the smallest change noticed, and the results that hang on it.

    Without `looked_at` it is seen before every step and motion. `noticeable_mm` is None where the change is
    no displacement of the guide against the head.
    """

    subject: Subject
    seen_by: str
    notices: str
    hangs: tuple[str, ...]
    looked_at: tuple[str, ...] = ()
    noticeable_mm: float | None = None

    @property
    def unnoticed_rms_mm(self) -> float:
        """Rms of a displacement of which every size up to the smallest noticeable one is equally likely."""
        return (self.noticeable_mm or 0.0) / math.sqrt(3.0)


CONFIRMATION = "confirmation"
LOOKS_AT_ROOM = (
    *("global_localization", "relocalization", "tool_change", "tool_check", "positioning"),
    CONFIRMATION,
)
WATCHED = (
    Watched(
        Subject.HEAD,
        "the spheres on it, by the tracker",
        f"{HEAD_NOTICEABLE_MM:g} mm rms",
        ("global_localization", "registration"),
        LOOKS_AT_ROOM,
        HEAD_NOTICEABLE_MM,
    ),
    Watched(
        Subject.BASE,
        "the frame on the arm, by tracker and arm",
        f"{BASE_NOTICEABLE_MM:g} mm",
        ("cart_lock", "global_localization"),
        LOOKS_AT_ROOM,
        BASE_NOTICEABLE_MM,
    ),
    Watched(
        Subject.GUIDE,
        "dials of the gauge",
        f"{GUIDE_NOTICEABLE_MM:g} mm at its end",
        ("tool_check",),
        ("tool_check", CONFIRMATION),
        GUIDE_NOTICEABLE_MM,
    ),
    Watched(
        Subject.CAMERAS,
        "rays that meet and spheres of the right size",
        "as the stereo head's record states",
        ("relocalization",),
        ("relocalization",),
    ),
    Watched(Subject.INPUTS, "their content", "any byte", ("ct_import", "plan_check", "cart_lock")),
    Watched(Subject.CLOCK, "the monotonic clock", "a step of 1 s", ()),
)


def last_seen_s(journal: Iterable[Line], confirms: Callable[[str, Subject], bool]) -> dict[Subject, float]:
    """Theatre time at which each subject was last seen to be as it was, according to a journal.

    `confirms` says of a look after a target, by its record, whether it saw a subject unchanged.
    """
    seen_s: dict[Subject, float] = {}
    for line in journal:
        step = str(line.get("step", "")).partition(":")[0]
        for one in WATCHED:
            looked = line["entry"] == Entry.RESULT and step in one.looked_at
            looked = looked and (step != CONFIRMATION or confirms(str(line.get("record")), one.subject))
            if looked or (not one.looked_at and line["entry"] in (Entry.INTENT, Entry.MOTION)):
                seen_s[one.subject] = theatre_time_s(line)
    return seen_s


class SeenUnchanged(Values):
    """One subject at a look after a target."""

    subject: Subject = Field(description="Head, cart and tracker, or guide.")
    moved_mm: float | None = Field(description="How far it was from its place; none if it was not seen.")
    noticeable_mm: float = Field(description="Smallest displacement that is taken for a change.")
    differs: bool = Field(default=False, description="Whether it has changed otherwise, such as by a tilt.")

    @classmethod
    def head(cls, moved_mm: float | None) -> SeenUnchanged:
        """The head, by the rms of its spheres."""
        return cls(subject=Subject.HEAD, moved_mm=moved_mm, noticeable_mm=HEAD_NOTICEABLE_MM)

    @classmethod
    def base(cls, shift: BaseShift | None) -> SeenUnchanged:
        """Cart and tracker, by the frame on the arm."""
        moved_mm, limit_mm = (None, BASE_NOTICEABLE_MM) if shift is None else (shift.moved_mm, shift.limit_mm)
        return cls(subject=Subject.BASE, moved_mm=moved_mm, noticeable_mm=limit_mm)

    @classmethod
    def guide(cls, off_mm: float | None, *, differs: bool = False) -> SeenUnchanged:
        """The guide, on its gauge."""
        return cls(subject=Subject.GUIDE, moved_mm=off_mm, noticeable_mm=GUIDE_NOTICEABLE_MM, differs=differs)

    @property
    def unchanged(self) -> bool:
        """Seen, and moved by less than would be noticed."""
        return self.moved_mm is not None and self.moved_mm < self.noticeable_mm and not self.differs

    def __str__(self) -> str:
        """One phrase for the operator."""
        if self.moved_mm is None:
            return f"{self.subject} not seen"
        return f"{self.subject} within {self.moved_mm:.2f} mm"


def unnoticed_mm() -> dict[str, float]:
    """Rms error by source of what no look would notice, for the prediction at a target."""
    return {f"unnoticed change: {one.subject}": one.unnoticed_rms_mm for one in WATCHED if one.noticeable_mm}
