"""Planned motions of the workcell, and the facts about them stated in a question.

The operator confirms exactly what the arm then drives.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from procedures.journal.journal import JournalValue
from procedures.operator.question import ReadBack
from procedures.workcell.arm_history import InsertionAxis, MotionKind
from ronna_hw.arm.errors import NotClear
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.path_preview import PathPreview
from ronna_hw.arm.pose import Pose
from ronna_hw.devices import JointMove, Motion, RobotArm
from ronna_hw.text import format_count
from ronna_hw.vectors import JointVector


@dataclass(frozen=True)
class PlannedMotion:
    """Motion of the workcell from the arm's present position: joint moves, or lines along one axis.

    If its first leg is not clear, any motions of `replacement` replace it. They are separate
    motions, so that the journal has the arm's actual way.
    """

    what: MotionKind
    mover: str  # such as `the guide`
    to: tuple[float, ...]  # joints in rad, or the tool's position in mm
    legs: tuple[Motion, ...]
    replacement: tuple[PlannedMotion, ...] = ()
    detour: str = "via home"  # what `replacement` is
    axis: InsertionAxis | None = None  # along which it leads

    @property
    def trajectory(self) -> str | None:
        """Trajectory along whose axis the motion leads; None for other motions."""
        return None if self.axis is None else self.axis.trajectory

    def as_intent(self) -> dict[str, JournalValue]:
        """Return the motion as plain values for the journal."""
        axis: dict[str, JournalValue] = {} if self.axis is None else {"axis": self.axis.as_plain()}
        return {"what": self.what, "to": list(self.to), "trajectory": self.trajectory, **axis}


Preview = Callable[[Motion, JointVector], PathPreview]  # of a motion from these joints


@dataclass(frozen=True)
class MotionFacts:
    """Facts about a motion before it is made, from the previews of its legs."""

    what: str  # the moving tool, such as `the guide`
    travel_mm: float  # sum of the straight distances: of the tool on a line, of the flange in a joint move
    previews: tuple[PathPreview, ...]
    detour: str = ""  # such as `via home`

    def __str__(self) -> str:
        moves = f"{self.what} moves {_format_nonzero(self.travel_mm)} mm{self.by}, {self.turn()}"
        return "; ".join((f"{moves}, {self.duration()} at {self.speed()}", *self.clearances()))

    @property
    def by(self) -> str:
        """The detour with a leading space, or an empty string."""
        return self.detour and f" {self.detour}"

    def turn(self) -> str:
        turns_rad = [high - low for one in self.previews for low, high in one.joint_ranges_rad]
        return f"joints turn up to {_format_nonzero(math.degrees(max(turns_rad)))} deg"

    def speed(self) -> str:
        return f"up to {_format_nonzero(max(one.largest_speed_mm_s for one in self.previews))} mm/s"

    def duration(self) -> str:
        return f"in {sum(one.duration_s for one in self.previews):.1f} s"

    def clearances(self) -> list[str]:
        """Describe the closest pair of bodies and, unless implied, the distance from the head."""
        nearest = [one.refused or one.closest for one in self.previews]
        closest = min((one for one in nearest if one), key=lambda one: one.distance_mm, default=None)
        to_head_mm = [one.nearest_to_head_mm for one in self.previews if one.nearest_to_head_mm is not None]
        statements = ["nothing near"]
        if closest:
            statements = [f"{closest.first} clears {closest.second} by {closest.distance_mm:.0f} mm"]
        if to_head_mm and not (closest and min(to_head_mm) <= closest.distance_mm):  # else already stated
            statements.append(f"at least {min(to_head_mm):.0f} mm from the head")
        return statements

    def require_clear(self) -> None:
        """Raise ARM-007 if a path is not clear."""
        for refused in (one.refused for one in self.previews if one.refused is not None):
            raise NotClear(
                f"as {self.what} moves {_format_nonzero(self.travel_mm)} mm{self.by}, the {refused.first} "
                f"would come too close to the {refused.second}",
                got=f"{refused.distance_mm:.1f} mm",
            )

    @property
    def read_back(self) -> ReadBack:
        """Distance that the operator must type back to prove that the question was read."""
        distance_mm = _format_nonzero(self.travel_mm)
        return ReadBack(
            "how many mm it moves first",
            distance_mm,
            wrong="is not it: read the question again, and type the distance of its first motion.",
            shown=f"moves {distance_mm} mm",
            unit="mm",
        )


@dataclass(frozen=True)
class AnnouncedMotions:
    """Motions that an answer allows besides those asked about, as previewed when the paths were checked."""

    count: int
    small: str  # motions too small to be previewed, in words
    duration_s: float
    largest_speed_mm_s: float
    clearance: str


def describe_motions(
    facts: Sequence[MotionFacts], announced: AnnouncedMotions | None = None, covers: str = ""
) -> str:
    """Describe motions in four lines: the first one, what follows, the closest bodies, the speed.

    `covers` says what else the answer allows.
    """
    if not facts:
        return covers
    first, *others = facts
    previews = tuple(preview for one in facts for preview in one.previews)
    together = MotionFacts(first.what, sum(one.travel_mm for one in facts), previews)
    follows = [f"{_format_nonzero(one.travel_mm)} mm{one.by}" for one in others]
    near, pace = (
        ", ".join(together.clearances()),
        f"{together.speed()}, {together.duration()}; {together.turn()}",
    )
    if announced is not None:
        follows += [f"{format_count(announced.count, 'motion')} of this step", announced.small]
        near += f"; later {announced.clearance}"
        pace += f"; later up to {announced.largest_speed_mm_s:.0f} mm/s, in {announced.duration_s:.0f} s"
    return "\n".join(
        (
            f"first: {first.what} moves {_format_nonzero(first.travel_mm)} mm{first.by}",
            f"then: {'; '.join(one for one in (', '.join(follows), covers) if one) or 'it rests'}",
            f"closest: {near}",
            f"speed: {pace}",
        )
    )


def motion_facts(arm: RobotArm, motions: Sequence[PlannedMotion]) -> list[MotionFacts]:
    """Return the facts of consecutive motions from the current position. Raises as `RobotArm.preview`."""
    here = arm.read_state()
    at_rad = here.commanded_rad or here.joints_rad  # as `preview` by default
    return collect_facts(at_rad, arm.kinematics, lambda leg, rad: arm.preview(leg, start_rad=rad), motions)


def collect_facts(
    at_rad: JointVector, kinematics: Kinematics, preview: Preview, motions: Sequence[PlannedMotion]
) -> list[MotionFacts]:
    """Return the facts of consecutive motions that start at the joints `at_rad`."""

    def facts_of(
        motion: PlannedMotion, legs: Sequence[Motion], from_rad: JointVector, detour: str = ""
    ) -> tuple[MotionFacts, JointVector]:
        travel_mm, previews = 0.0, []
        for leg in legs:
            previews.append(preview(leg, from_rad))
            travel_mm += _travel_mm(kinematics, leg, from_rad)
            from_rad = joints_after(kinematics, leg, from_rad)
        return MotionFacts(motion.mover, travel_mm, tuple(previews), detour), from_rad

    facts: list[MotionFacts] = []
    for motion in motions:
        own_facts, end_rad = facts_of(motion, motion.legs, at_rad)
        if motion.replacement and not own_facts.previews[0].clear:
            legs = [leg for one in motion.replacement for leg in one.legs]
            own_facts, end_rad = facts_of(motion, legs, at_rad, motion.detour)
        facts.append(own_facts)
        at_rad = end_rad
    return facts


def joints_after(kinematics: Kinematics, leg: Motion, start_rad: JointVector) -> JointVector:
    """Return the joints at the end of a leg from `start_rad` on. Raises as `Kinematics.solve_branch`."""
    if isinstance(leg, JointMove):
        return leg.target_rad
    flange = leg.target if leg.flange_from_tool is None else leg.target @ leg.flange_from_tool.inverse()
    return kinematics.solve_branch(Pose.from_transform(flange), kinematics.branch_of(start_rad), start_rad)


def _travel_mm(kinematics: Kinematics, motion: Motion, start_rad: JointVector) -> float:
    here = kinematics.flange_pose(start_rad)
    if isinstance(motion, JointMove):
        there = kinematics.flange_pose(motion.target_rad)
    else:
        there = motion.target
        here = here if motion.flange_from_tool is None else here @ motion.flange_from_tool
    return math.dist(there.translation_mm, here.translation_mm)


def _format_nonzero(value: float) -> str:
    """Format as a whole number, or with one decimal if that would read 0."""
    return f"{value:.1f}" if 0.05 <= value < 0.5 else f"{value:.0f}"
