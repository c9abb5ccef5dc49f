"""What a motion will do, in the words of a question: what moves, how far, how fast, how close to what."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from procedures.engine.operator import ReadBack
from procedures.workcell.carried_tool import CarriedTool
from ronna_hw.arm.calibrated import CalibratedArm
from ronna_hw.arm.clearance.swept_path import Closest
from ronna_hw.arm.preview import PathPreview
from ronna_hw.devices import RobotArm
from ronna_hw.devices.readings import JointVector
from ronna_hw.frames import Transform


@dataclass(frozen=True)
class MotionFacts:
    """One motion before it is driven."""

    what: str  # that moves, such as `the guide`
    travel_mm: float  # straight distance of the tip on a line, of the flange in a joint move
    largest_turn_rad: float  # of any joint
    preview: PathPreview

    def __str__(self) -> str:
        """One line for a person."""
        closest = self.preview.refused or self.preview.closest
        near = (
            f"{closest.first} passes {closest.second} at {closest.distance_mm:.0f} mm"
            if closest
            else "nothing near"
        )
        return (
            f"{self.what} moves {self.travel_mm:.0f} mm, joints turn up to "
            f"{math.degrees(self.largest_turn_rad):.0f} deg, in {self.preview.duration_s:.1f} s "
            f"at up to {self.preview.largest_speed_mm_s:.0f} mm/s; {near}{self._from_head(closest)}"
        )

    def _from_head(self, closest: Closest | None) -> str:
        """How near the head it comes: bodies of the arm are nearly always nearest to each other."""
        nearest_mm = self.preview.nearest_to_head_mm
        if nearest_mm is None or (closest and nearest_mm <= closest.distance_mm):  # it is said already
            return ""
        return f"; {nearest_mm:.0f} mm from the head at the least"

    @property
    def read_back(self) -> ReadBack:
        """The distance, which only who reads the line knows."""
        distance_mm = f"{self.travel_mm:.0f}"
        return ReadBack(
            "how many mm it moves first",
            distance_mm,
            wrong=f"is not it: the question says that it moves {distance_mm} mm first.",
            shown=f"moves {distance_mm} mm",
            unit="mm",
        )


def motion_facts(
    arm: RobotArm,
    here_rad: JointVector,
    goal: JointVector | Transform,
    calibrated: CalibratedArm,
    carried: Callable[[], CarriedTool],
    what: str,
) -> MotionFacts:
    """What a joint move, or a line of the carried tool to a pose ROBOT <- TOOL, would do from here."""
    if isinstance(goal, Transform):
        tool = carried()
        preview = arm.preview(tool.told(goal, lambda: here_rad), flange_from_tool=tool.flange_from_tool)
        travel_mm = math.dist(goal.translation_mm, tool.pose(here_rad).translation_mm)
        turns_rad = [high - low for low, high in preview.joint_ranges_rad]
    else:
        preview = arm.preview(goal)
        there, here = calibrated.flange_pose(goal), calibrated.flange_pose(here_rad)
        travel_mm = math.dist(there.translation_mm, here.translation_mm)
        turns_rad = [abs(to - now) for to, now in zip(goal, here_rad, strict=True)]
    return MotionFacts(what, travel_mm, max(turns_rad), preview)


def in_sequence(motions: Sequence[MotionFacts]) -> str:
    """Several motions in their order, as one question shows them."""
    return "; then ".join(map(str, motions))
