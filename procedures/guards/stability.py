"""Stability of the room during a case: how each part is observed, and what a look after a target found.

Before and after each target the arm is home, where the tracker sees everything and the arm is in the same
pose; at the target it is close to what counts. A move between two looks is found by the second and casts
doubt on every target worked at since the first. A change too small for any look is a share of the predicted
error (`procedures.room`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum

from pydantic import Field

from procedures.journal.journal import Entry, Line, theatre_time_s
from procedures.journal.results import Values
from procedures.registration.movement import LEAST_POINTS
from ronna_hw.arm.catalogue import find_arm

# On its gauge; beyond it, the guide is not as it was when its tip was calibrated. For an arm that repeats
# within `REPEATABLE_MM` per axis; one that repeats less well shows less.
# Safety against a guide that is not as it was calibrated (U).
GUIDE_NOTICEABLE_MM, REPEATABLE_MM = 0.05, 0.015

CONFIRMATION = "confirmation"
LOOKS_AT_ROOM = (
    *("global_localization", "relocalization", "surface_scan", "tool_change", "tool_check", "positioning"),
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

    Without `looked_at` it is seen before every step and motion.
    """

    subject: Subject
    seen_by: str
    notices: str
    hangs: tuple[str, ...]
    looked_at: tuple[str, ...] = ()


AT_TARGETS = "at each target, by its lever: the second figure there"


def guide_noticeable_mm(arm: str) -> float:
    """Return the displacement of the guide from which on its gauge shows it, with this model of arm."""
    return GUIDE_NOTICEABLE_MM * max(1.0, find_arm(arm).repeatability_mm / REPEATABLE_MM)


def guide_unnoticed_mm(arm: str) -> float:
    """Return the rms of a displacement of the guide that its gauge does not show, with this model of arm."""
    return guide_noticeable_mm(arm) / math.sqrt(3.0)  # uniformly distributed up to the limit


WATCHED_SUBJECTS = (
    WatchedSubject(
        Subject.HEAD,
        "the spheres on it, by the tracker",
        AT_TARGETS,
        ("global_localization", "registration"),
        LOOKS_AT_ROOM,
    ),
    WatchedSubject(
        Subject.BASE,
        "the frame on the arm, by tracker and arm",
        AT_TARGETS,
        ("cart_lock", "global_localization"),
        LOOKS_AT_ROOM,
    ),
    WatchedSubject(
        Subject.GUIDE,
        "dials of the gauge",
        f"{GUIDE_NOTICEABLE_MM:g} mm at its end; more with an arm that repeats less well",
        ("tool_check",),
        ("tool_check", CONFIRMATION),
    ),
    WatchedSubject(
        Subject.CAMERAS,
        "rays that meet and spheres of the right size",
        "as the stereo head's record states",
        ("relocalization",),
        ("relocalization", "surface_scan"),
    ),
    WatchedSubject(Subject.INPUTS, "their content", "any byte", ("ct_import", "plan_check", "cart_lock")),
    WatchedSubject(Subject.CLOCK, "the monotonic clock", "a step of 1 s", ()),
)


BY_CLAMP = "the frame on its clamp, by the tracker"
LINES = "lines in one plane of light"


def watched_subjects(beside_skin: int | None = None) -> tuple[WatchedSubject, ...]:
    """Return the watched subjects of a case with spheres, or with so many beside the skin."""
    if beside_skin is None:
        return WATCHED_SUBJECTS
    changed = {
        Subject.HEAD: (_see_head(beside_skin), ("global_localization", "surface_registration")),
        Subject.CAMERAS: (
            f"rays that meet, spheres of the right size, and {LINES}"
            if beside_skin
            else f"rays that meet, and {LINES}",
            ("surface_scan",),
        ),
    }
    words = {one.subject: changed.get(one.subject, (one.seen_by, one.hangs)) for one in WATCHED_SUBJECTS}
    return tuple(
        replace(one, seen_by=words[one.subject][0], hangs=words[one.subject][1]) for one in WATCHED_SUBJECTS
    )


def _see_head(spheres: int) -> str:
    """Say by what the tracker sees a head with so many spheres, whose clamp has a frame.

    At rest every sphere counts (`procedures.room`); while the arm moves, they do from three on.
    """
    if not spheres:
        return BY_CLAMP
    on_head = "the sphere on it" if spheres == 1 else "the spheres on it"
    seen = f"{on_head} and {BY_CLAMP}"
    return seen if spheres >= LEAST_POINTS else f"{seen}; while the arm moves, by the frame alone"


def tell_unseen_slip(spheres: int) -> str:
    """Say which slip of a head in its clamp the tracker does not see, with so many spheres on it; '' if none.

    Three spheres show where the head is without the clamp's frame, and what they leave open is predicted.
    """
    if spheres >= LEAST_POINTS:
        return ""
    if not spheres:
        return "a head that slips in its clamp, of which the tracker sees the frame alone"
    shows, about = ("sphere shows", "it") if spheres == 1 else ("spheres show", "the line through them")
    return f"a head that slips in its clamp by less than its {shows}, or turns about {about}"


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
    moved_mm: float | None = Field(
        description="Displacement of the guide at the target by its motion, of the guide that on its gauge; "
        "none if it was not seen."
    )
    noticeable_mm: float = Field(description="Displacement from which on that would have been noticed.")
    differs: bool = Field(default=False, description="Whether it has changed otherwise, such as by a tilt.")

    @classmethod
    def guide(cls, off_mm: float | None, noticeable_mm: float, *, differs: bool = False) -> SeenUnchanged:
        """Build the finding on the guide from its gauge measurement."""
        return cls(subject=Subject.GUIDE, moved_mm=off_mm, noticeable_mm=noticeable_mm, differs=differs)

    @property
    def unchanged(self) -> bool:
        """Whether the subject was seen, with a displacement below the detection limit."""
        return self.moved_mm is not None and self.moved_mm < self.noticeable_mm and not self.differs

    def __str__(self) -> str:
        if self.moved_mm is None:
            return f"{self.subject} not seen"
        if self.differs:
            return f"{self.subject} changed, by {self.moved_mm:.2f} mm"
        return f"{self.subject} {self.moved_mm:.2f} mm (noticed from {self.noticeable_mm:.2f} mm)"
