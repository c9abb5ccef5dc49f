"""A motion of the case as it was previewed, in records."""

from __future__ import annotations

from collections.abc import Sequence

from pydantic import Field

from procedures.journal.results import Values
from procedures.planning.path_check.motions import PreviewedMotion
from ronna_hw.arm.clearance.swept_path import Closest
from ronna_hw.text.counting import counted

SPHERE = "/fiducial "  # in the name of a pose, before its number


class ClosestApproach(Values):
    """Where two bodies come nearest."""

    first: str = Field(description="One body.")
    second: str = Field(description="The other.")
    distance_mm: float = Field(description="Between their surfaces.")
    at: float = Field(description="Where on the path, 0 to 1.")

    @classmethod
    def of(cls, closest: Closest) -> ClosestApproach:
        """As the clearance check has it."""
        return cls(
            first=closest.first, second=closest.second, distance_mm=closest.distance_mm, at=closest.fraction
        )


class MotionPreview(Values):
    """One motion, from one named pose to another."""

    start: str = Field(description="Name of the pose it begins at.")
    end: str = Field(description="Name of the pose it ends at.")
    kind: str = Field(description="`move` of the joints, straight `line`, or `back` on it.")
    duration_s: float = Field(description="Duration at the intended speed.")
    clear: bool = Field(description="Whether every body keeps enough clearance.")
    closest: ClosestApproach | None = Field(description="The closest pair of bodies.")
    largest_joint_speed_share: float = Field(description="Of the limits of the motion.")
    largest_speed_mm_s: float = Field(description="Largest speed of any moving body.")
    nearest_to_head_mm: float | None = Field(
        description="Smallest distance of any moving body from the head."
    )

    @classmethod
    def of(cls, motion: PreviewedMotion) -> MotionPreview:
        """As the planner previewed it."""
        preview = motion.preview
        return cls(
            start=motion.motion.start,
            end=motion.motion.end,
            kind=motion.motion.kind,
            duration_s=preview.duration_s,
            clear=preview.clear,
            closest=None if preview.closest is None else ClosestApproach.of(preview.closest),
            largest_joint_speed_share=preview.largest_joint_speed_share,
            largest_speed_mm_s=preview.largest_speed_mm_s,
            nearest_to_head_mm=preview.nearest_to_head_mm,
        )


def motions_over_spheres(motions: Sequence[MotionPreview], trajectory: str | None) -> list[MotionPreview]:
    """Those of one localization, by way of home too: of a trajectory, or the one that serves all."""
    own = f"{trajectory}/" if trajectory else ""
    over = [place for place, one in enumerate(motions) if one.end.startswith(own) and SPHERE in one.end]
    return list(motions[over[0] : over[-1] + 1]) if over else []


def in_one_line(motions: Sequence[MotionPreview]) -> str:
    """At least one: how many, how long, how fast and how close."""
    near = min((one.closest for one in motions if one.closest), key=lambda one: one.distance_mm, default=None)
    return (
        f"{counted(len(motions), 'motion')} in {sum(one.duration_s for one in motions):.0f} s at up to "
        f"{max(one.largest_speed_mm_s for one in motions):.0f} mm/s; "
        + (f"{near.first} clears {near.second} by {near.distance_mm:.0f} mm" if near else "nothing near")
    )
