"""Depths and forces by which the skull is drilled, also below an opening that was begun earlier.

A repetition starts from what the journal has of the feeds before. It is fed on only where bone resisted up to
where they ended: where nothing did, or where an end is not recorded, the opening may be through.
"""

from __future__ import annotations

from typing import NamedTuple

from procedures.planning.skull_section import SkullSection
from procedures.steps.clinical.results import CranialOpening, FeedEnd
from procedures.steps.clinical.two_arms.skull_opening import EARLY_MM, TOUCH_N
from procedures.workcell.assistant import DrillPlan
from ronna_hw.devices.contact import DrillLimits

# Safety against a drill fed too fast (U).
FEED_MM_S = 0.5  # a stop from there takes a hundredth of a mm
# Behind the inside of the skull by the CT the stop rests on the guide, and no set-point is beyond. It leaves
# room for the point of the drill and what CT and arms err.
# Safety against a drill that plunges (U).
BEHIND_SKULL_MM = 2.5
# Safety against a drill that is switched on in bone (U).
BEFORE_BONE_MM = 2.0  # of the tip, where the drill is switched on: more than CT and arms err
# Safety against a drill pressed until its limit trips (U).
SLOW_SHARE = 0.6  # of the limit: from there on the feed is slowed
# Across the axis: an arm of 80 N/mm yields by 0.1 mm, half of what the guide may move.
# Safety against a drill that is pressed aside (U).
SIDE_N = 8.0
# Hard steel under oil 0.1 to 0.23, dry 0.42 (Kirk-Othmer, Lubrication and Lubricants), and 0.03 of the force
# across that a sensor takes for one along. A drill that turns in its guide has hardly any along its axis.
# Safety against friction in the guide taken for bone (U).
FRICTION = 0.45  # share of the force across the drill
# Safety against a drill whose force says nothing: a wrong scale, a dead axis (U).
BLIND_MM = 0.5  # by which a feed without bone may have been longer
BONE_BY_MM = 2.0  # behind the skull's outside by the CT
# Safety against an opening that is drilled again although it is through (U).
AGAIN_MM = 1.0  # behind the bottom of an opening begun in bone: more than the arms err when they come again
RESISTED_WITHIN_MM = 0.2  # of the end of a feed, or nothing resisted there: more than the joints err
# Safety against a breakthrough that is not noticed (U).
FREE_N = 1.0  # two standard errors of a sensor's force at most; diploe resists with 2 N (U)
FALL_SHARE = 0.4  # of the force in the inner cortex: the point of the drill is through (U)
FREE_MM = 0.6  # of feed without any resistance: thinner than any diploe without bone (U)


class DrillDepths(NamedTuple):
    """Depths behind the entry, and how far the clamp is from the start of its axis at depth 0."""

    skull: SkullSection
    at_entry_mm: float

    @property
    def deepest_mm(self) -> float:
        return self.skull.inside_mm + BEHIND_SKULL_MM

    @property
    def from_mm(self) -> float:
        return self.skull.outside_mm - BEFORE_BONE_MM

    def bone_by_mm(self, bottom_mm: float | None) -> float:
        """Return where bone must have been felt, in an opening begun in bone behind its bottom."""
        if bottom_mm is None:
            return self.skull.outside_mm + BONE_BY_MM
        return min(bottom_mm + AGAIN_MM, self.deepest_mm - BLIND_MM)


class BegunOpening(NamedTuple):
    """Opening begun earlier: the deepest place of the drill, and its last feed as far as recorded."""

    depth_mm: float
    last: CranialOpening | None

    @classmethod
    def of(cls, reached_mm: float | None, last: CranialOpening | None) -> BegunOpening | None:
        """Take where the drill was switched off, and the last record; None if none was begun."""
        depths_mm = [reached_mm, None if last is None else last.depth_mm]
        known_mm = [one for one in depths_mm if one is not None]
        return cls(max(known_mm), last) if known_mm else None

    @property
    def bottom_mm(self) -> float | None:
        """Its bottom, in bone; None if no bone was felt."""
        return None if self.last is None or self.last.resisted_mm is None else self.depth_mm

    def why_by_hand(self, depths: DrillDepths) -> str:
        """Return why it may be through, so that only a hand goes on there; '' if it is not."""
        if self.last is not None and self.last.end is FeedEnd.UNKNOWN:
            return "drilling was begun there, and how deep it went is not recorded"
        begun = f"drilling was begun there, with the tip {self.depth_mm:.1f} mm behind the entry"
        if self.last is None or self.last.resisted_mm is None:
            is_blind = self.depth_mm > depths.bone_by_mm(None) + BLIND_MM
            return f"{begun}, and no record says that bone resisted" if is_blind else ""
        resisted_mm = self.last.resisted_mm
        if self.depth_mm - resisted_mm > RESISTED_WITHIN_MM:
            return f"{begun}, and bone resisted only up to {resisted_mm:.1f} mm"
        return ""


def plan_feed(depths: DrillDepths, limit_N: float, begun: BegunOpening | None) -> DrillPlan:
    """Plan a feed, below an opening begun earlier if there is one that is not through."""
    bottom_mm, deepest_mm = None if begun is None else begun.bottom_mm, depths.deepest_mm
    limits = DrillLimits(
        slow_N=SLOW_SHARE * limit_N,
        touch_N=TOUCH_N,
        free_N=FREE_N,
        fall_share=FALL_SHARE,
        earliest_mm=BEHIND_SKULL_MM + EARLY_MM,
        free_mm=FREE_MM,
        bone_from_mm=0.0 if bottom_mm is None else deepest_mm - bottom_mm,
        bone_by_mm=deepest_mm - depths.bone_by_mm(bottom_mm),
        side_N=SIDE_N,
        friction=FRICTION,
    )
    at_entry_mm = depths.at_entry_mm
    return DrillPlan(at_entry_mm + depths.from_mm, at_entry_mm + deepest_mm, FEED_MM_S, limit_N, limits)
