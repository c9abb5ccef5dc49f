"""Stability of the room during a case: how each part is observed, and the smallest detectable change.

Before and after each target the arm is home, where the tracker sees everything and the arm is in the same
pose: only there is a change noticed that is small enough to matter at a target. A move between two such looks
is found by the second and casts doubt on every target worked at since the first. A change too small for
either is a share of the predicted error.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import StrEnum

from pydantic import Field

from procedures.journal.journal import Entry, Line, theatre_time_s
from procedures.journal.results import Values

CAREFUL_FRAMES = 60  # of the tracker, at home: a second of the usual 60 Hz
# Rms of the spheres over that many frames: 0.085 mm at most in 400 simulated pairs of readings of three.
HEAD_NOTICEABLE_MM = 0.15
# The frame on the arm at home, between tracker and arm, each joint arriving from the same side: noise and
# repeatability, 0.11 mm at most in 3,000 simulated pairs. From other sides, backlash adds up to 0.52 mm.
BASE_NOTICEABLE_MM = 0.15
GUIDE_NOTICEABLE_MM = 0.05  # on its gauge; beyond it, the guide is not as it was when its tip was calibrated
CONFIRMATION = "confirmation"
IN_PUSHES = "unnoticed change: head while the tracker was pushed"
LOOKS_AT_ROOM = (
    *("global_localization", "relocalization", "tool_change", "tool_check", "positioning"),
    CONFIRMATION,
)


class Subject(StrEnum):
    """Part of the room that must not change."""

    HEAD = "head"
    BASE = "cart and tracker"
    GUIDE = "guide"
    CAMERAS = "cameras"
    INPUTS = "CT, plan and records"
    CLOCK = "clock"


@dataclass(frozen=True)
class WatchedSubject:
    """Watched subject: observation method, steps, smallest detectable change, and dependent results.

    Without `looked_at` it is seen before every step and motion. `noticeable_mm` is None if a change does not
    displace the guide against the head.
    """

    subject: Subject
    seen_by: str
    notices: str
    hangs: tuple[str, ...]
    looked_at: tuple[str, ...] = ()
    noticeable_mm: float | None = None

    @property
    def unnoticed_rms_mm(self) -> float:
        """Rms of an undetected displacement, uniformly distributed up to the detection limit."""
        return (self.noticeable_mm or 0.0) / math.sqrt(3.0)


WATCHED_SUBJECTS = (
    WatchedSubject(
        Subject.HEAD,
        "the spheres on it, by the tracker",
        f"{HEAD_NOTICEABLE_MM:g} mm rms",
        ("global_localization", "registration"),
        LOOKS_AT_ROOM,
        HEAD_NOTICEABLE_MM,
    ),
    WatchedSubject(
        Subject.BASE,
        "the frame on the arm, by tracker and arm",
        f"{BASE_NOTICEABLE_MM:g} mm",
        ("cart_lock", "global_localization"),
        LOOKS_AT_ROOM,
        BASE_NOTICEABLE_MM,
    ),
    WatchedSubject(
        Subject.GUIDE,
        "dials of the gauge",
        f"{GUIDE_NOTICEABLE_MM:g} mm at its end",
        ("tool_check",),
        ("tool_check", CONFIRMATION),
        GUIDE_NOTICEABLE_MM,
    ),
    WatchedSubject(
        Subject.CAMERAS,
        "rays that meet and spheres of the right size",
        "as the stereo head's record states",
        ("relocalization",),
        ("relocalization",),
    ),
    WatchedSubject(Subject.INPUTS, "their content", "any byte", ("ct_import", "plan_check", "cart_lock")),
    WatchedSubject(Subject.CLOCK, "the monotonic clock", "a step of 1 s", ()),
)


def last_seen_s(journal: Iterable[Line], confirms: Callable[[str, Subject], bool]) -> dict[Subject, float]:
    """Return the theatre time at which each subject was last confirmed unchanged in a journal.

    `confirms` tells whether the look after a target, given by its record, saw a subject unchanged.
    """
    seen_s: dict[Subject, float] = {}
    for line in journal:
        step = str(line.get("step", "")).partition(":")[0]
        for one in WATCHED_SUBJECTS:
            was_looked_at = line["entry"] == Entry.RESULT and step in one.looked_at
            was_looked_at = was_looked_at and (
                step != CONFIRMATION or confirms(str(line.get("record")), one.subject)
            )
            if was_looked_at or (not one.looked_at and line["entry"] in (Entry.INTENT, Entry.MOTION)):
                seen_s[one.subject] = theatre_time_s(line)
    return seen_s


class SeenUnchanged(Values):
    """Finding on one subject from the check after a target."""

    subject: Subject = Field(description="Head, cart and tracker, or guide.")
    moved_mm: float | None = Field(description="How far it was from its place; none if it was not seen.")
    noticeable_mm: float = Field(description="Smallest displacement that is taken for a change.")
    differs: bool = Field(default=False, description="Whether it has changed otherwise, such as by a tilt.")

    @classmethod
    def head(cls, moved_mm: float | None) -> SeenUnchanged:
        """Build the finding on the head from the rms displacement of its spheres."""
        return cls(subject=Subject.HEAD, moved_mm=moved_mm, noticeable_mm=HEAD_NOTICEABLE_MM)

    @classmethod
    def base(cls, moved_mm: float | None, limit_mm: float = BASE_NOTICEABLE_MM) -> SeenUnchanged:
        """Build the finding on cart and tracker from the frame on the arm."""
        return cls(subject=Subject.BASE, moved_mm=moved_mm, noticeable_mm=limit_mm)

    @classmethod
    def guide(cls, off_mm: float | None, *, differs: bool = False) -> SeenUnchanged:
        """Build the finding on the guide from its gauge measurement."""
        return cls(subject=Subject.GUIDE, moved_mm=off_mm, noticeable_mm=GUIDE_NOTICEABLE_MM, differs=differs)

    @property
    def unchanged(self) -> bool:
        """Whether the subject was seen, with a displacement below the detection limit."""
        return self.moved_mm is not None and self.moved_mm < self.noticeable_mm and not self.differs

    def __str__(self) -> str:
        """Describe the finding to the operator."""
        if self.moved_mm is None:
            return f"{self.subject} not seen"
        return f"{self.subject} within {self.moved_mm:.2f} mm"


def undetected_changes_mm(in_pushes_mm: float = 0.0) -> dict[str, float]:
    """Return the rms error due to undetectable changes, by source, for target error prediction.

    `in_pushes_mm` is the rms of moves of the head that followed pushes of the tracker may have hidden.
    """
    changes_mm = {
        f"unnoticed change: {one.subject}": one.unnoticed_rms_mm
        for one in WATCHED_SUBJECTS
        if one.noticeable_mm
    }
    return {**changes_mm, **({IN_PUSHES: in_pushes_mm} if in_pushes_mm else {})}
