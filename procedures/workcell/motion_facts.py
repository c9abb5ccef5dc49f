"""What a motion will do, in the words of a question: what moves, how far, how fast, how close to what."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from procedures.operator.question import ReadBack
from procedures.workcell.cell_motion import CellMotion
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.preview import PathPreview
from ronna_hw.devices import JointMove, Motion, RobotArm
from ronna_hw.devices.readings import JointVector


class PreviewingArm(Protocol):
    """What facts need: an arm, or a plan of one."""

    @property
    def kinematics(self) -> Kinematics:
        """Of the arm."""
        ...

    def preview(self, motion: Motion, *, start_rad: JointVector) -> PathPreview:
        """What a motion would do if driven from there."""
        ...


@dataclass(frozen=True)
class MotionFacts:
    """One motion before it is driven, in the previews of all that the arm does for it."""

    what: str  # that moves, such as `the guide`
    travel_mm: float  # straight distances of what keeps to a line, of the flange in a joint move
    previews: tuple[PathPreview, ...]
    detour: str = ""  # such as `via home`

    def __str__(self) -> str:
        """One line for a person."""
        return self.in_words(", ", self.near())

    def in_words(self, apart: str, near: Sequence[str]) -> str:
        """What moves how far, then `apart` from it the rest, with those clearances."""
        turns_rad = [high - low for one in self.previews for low, high in one.joint_ranges_rad]
        duration_s = sum(one.duration_s for one in self.previews)
        fastest_mm_s = max(one.largest_speed_mm_s for one in self.previews)
        by = self.detour and f" {self.detour}"
        how = (
            f"joints turn up to {_not_nothing(math.degrees(max(turns_rad)))} deg, in {duration_s:.1f} s "
            f"at up to {_not_nothing(fastest_mm_s)} mm/s"
        )
        return f"{self.what} moves {_not_nothing(self.travel_mm)} mm{by}{apart}" + "; ".join((how, *near))

    def near(self) -> list[str]:
        """What comes closest, and how near the head: bodies of the arm are nearly always closest together."""
        nearest = [one.refused or one.closest for one in self.previews]
        closest = min((one for one in nearest if one), key=lambda one: one.distance_mm, default=None)
        to_head_mm = [one.nearest_to_head_mm for one in self.previews if one.nearest_to_head_mm is not None]
        said = ["nothing near"]
        if closest:
            said = [f"{closest.first} clears {closest.second} by {closest.distance_mm:.0f} mm"]
        if to_head_mm and not (closest and min(to_head_mm) <= closest.distance_mm):  # else it is said already
            said.append(f"at least {min(to_head_mm):.0f} mm from the head")
        return said

    @property
    def read_back(self) -> ReadBack:
        """The distance, which only who reads the line knows."""
        distance_mm = _not_nothing(self.travel_mm)
        return ReadBack(
            "how many mm it moves first",
            distance_mm,
            wrong=f"is not it: the question says that it moves {distance_mm} mm first.",
            shown=f"moves {distance_mm} mm",
            unit="mm",
        )


def in_a_question(facts: Sequence[MotionFacts]) -> str:
    """All motions of a question: the distance to type ends its own line, and no clearance is said twice."""
    motions: list[str] = []
    said: set[str] = set()
    for one in facts:
        near = one.near()
        motions.append(
            one.in_words(", " if motions else ",\n", [words for words in near if words not in said])
        )
        said.update(near)
    return "; then ".join(motions)


def motion_facts(arm: RobotArm, motions: Sequence[CellMotion]) -> list[MotionFacts]:
    """What driving these motions one after the other would do. Raises what `RobotArm.preview` raises."""
    here = arm.read_state()
    return facts_from(here.commanded_rad or here.joints_rad, arm, motions)  # as `preview` begins by itself


def facts_from(at_rad: JointVector, arm: PreviewingArm, motions: Sequence[CellMotion]) -> list[MotionFacts]:
    """As `motion_facts`, from other joints than the arm has now."""
    facts: list[MotionFacts] = []
    for motion in motions:
        own_facts, end_rad = _facts(arm, motion, motion.legs, at_rad)
        if motion.otherwise and not own_facts.previews[0].clear:
            own_facts, end_rad = _facts(arm, motion, motion.otherwise, at_rad, motion.detour)
        facts.append(own_facts)
        at_rad = end_rad
    return facts


def _facts(
    arm: PreviewingArm, motion: CellMotion, legs: Sequence[Motion], at_rad: JointVector, detour: str = ""
) -> tuple[MotionFacts, JointVector]:
    """With the joints after the last joint move."""
    travel_mm, previews = 0.0, []
    for leg in legs:
        previews.append(arm.preview(leg, start_rad=at_rad))
        travel_mm += _travel_mm(arm.kinematics, leg, at_rad)
        if isinstance(leg, JointMove):
            at_rad = leg.target_rad
    return MotionFacts(motion.moves, travel_mm, tuple(previews), detour), at_rad


def _travel_mm(kinematics: Kinematics, motion: Motion, start_rad: JointVector) -> float:
    here = kinematics.flange_pose(start_rad)
    if isinstance(motion, JointMove):
        there = kinematics.flange_pose(motion.target_rad)
    else:
        there = motion.target
        here = here if motion.flange_from_tool is None else here @ motion.flange_from_tool
    return math.dist(there.translation_mm, here.translation_mm)


def _not_nothing(value: float) -> str:
    """Whole, or with one decimal where that would round to 0: something does move."""
    return f"{value:.1f}" if 0.05 <= value < 0.5 else f"{value:.0f}"
