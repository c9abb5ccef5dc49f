"""What a planned path will do, before it is driven: for people, for records, and for checking all paths."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, degrees, hypot, inf, isinf, sin
from typing import Any

import numpy as np

from ronna_hw.arm.clearance import Closest, SweptPath, motion_mm, sweep_path
from ronna_hw.arm.limits import MotionLimits
from ronna_hw.arm.model import ArmModel
from ronna_hw.arm.planning import MotionPlan
from ronna_hw.arm.progress import duration_s
from ronna_hw.arm.speed_zones import with_speed_steps
from ronna_hw.arm.surroundings import Surroundings
from ronna_hw.devices.readings import JointVector

CYCLE_S = 0.004  # of the generator that the duration is taken from


@dataclass(frozen=True)
class Singularity:
    """How far a path stays from the three singularities: each is 1 at best and 0 in the singular pose.

    `wrist` is |sin A5|, `elbow` the sine of the bend between upper arm and the line to the wrist centre,
    `shoulder` the distance of the wrist centre from the axis of A1 as a share of the reach.
    """

    wrist: float
    elbow: float
    shoulder: float

    @property
    def least(self) -> float:
        """The smallest of the three."""
        return min(self.wrist, self.elbow, self.shoulder)


@dataclass(frozen=True)
class PathPreview:
    """A planned path in numbers. Angles in rad, `largest_speed_mm_s` of anything that moves."""

    duration_s: float
    joint_ranges_rad: tuple[tuple[float, float], ...]
    closest: Closest | None
    refused: Closest | None
    singularity: Singularity
    largest_joint_speed_share: float  # of the limits of the motion
    largest_speed_mm_s: float
    nearest_to_head_mm: float | None

    @property
    def clear(self) -> bool:
        """Whether no body comes too near to another one."""
        return self.refused is None

    def as_payload(self) -> dict[str, Any]:
        """Plain numbers for a record or for JSON."""
        closest, singular = self.closest, self.singularity
        return {
            "duration_s": self.duration_s,
            "joint_ranges_rad": [list(limits) for limits in self.joint_ranges_rad],
            "clear": self.clear,
            "closest": None
            if closest is None
            else {
                "first": closest.first,
                "second": closest.second,
                "distance_mm": closest.distance_mm,
                "at": closest.parameter,
            },
            "singularity": {
                "wrist": singular.wrist,
                "elbow": singular.elbow,
                "shoulder": singular.shoulder,
            },
            "largest_joint_speed_share": self.largest_joint_speed_share,
            "largest_speed_mm_s": self.largest_speed_mm_s,
            "nearest_to_head_mm": self.nearest_to_head_mm,
        }

    def rows(self) -> tuple[tuple[str, str], ...]:
        """Name and value, for a table."""
        closest, head = self.closest, self.nearest_to_head_mm
        ranges = (
            f"A{axis} {degrees(low):.1f} .. {degrees(high):.1f}"
            for axis, (low, high) in enumerate(self.joint_ranges_rad, start=1)
        )
        return (
            ("duration", f"{self.duration_s:.2f} s"),
            ("joints, deg", ", ".join(ranges)),
            (
                "smallest distance",
                "nothing near"
                if closest is None
                else f"{closest.distance_mm:.1f} mm, {closest.first} to {closest.second}, "
                f"{closest.parameter:.0%} of the way",
            ),
            ("clear", "yes" if self.clear else "no"),
            ("nearest to the head", "-" if head is None else f"{head:.1f} mm"),
            ("largest speed", f"{self.largest_speed_mm_s:.0f} mm/s"),
            ("largest joint speed", f"{self.largest_joint_speed_share:.0%} of its limit"),
            ("distance from singularity", f"{self.singularity.least:.2f}"),
        )


def preview(
    model: ArmModel, plan: MotionPlan, surroundings: Surroundings, limits: MotionLimits
) -> PathPreview:
    """Look at a planned path as the arm would drive it in these surroundings.

    Raises ARM-001 to ARM-004 where the path has no solution; a path that is not clear is told, not raised.
    """
    path = sweep_path(model, plan, surroundings)
    slowed = with_speed_steps(plan, path)
    speeds = _speeds(path, slowed)
    joints = path.joints_rad
    rates = np.abs(np.diff(joints, axis=0)) / np.diff(path.parameters)[:, None]
    shares = (rates * speeds[:, None]) / np.array(limits.speed_rad_s)
    body = motion_mm(path.swept).max(axis=1, initial=0.0) / np.diff(path.parameters) * speeds
    nearest = float(path.swept.to_head_mm.min())
    return PathPreview(
        duration_s=0.0 if plan.is_standstill else duration_s(slowed.limits, slowed.speed_steps, CYCLE_S),
        joint_ranges_rad=tuple(
            (float(low), float(high)) for low, high in zip(joints.min(0), joints.max(0), strict=True)
        ),
        closest=path.closest,
        refused=path.refused,
        singularity=singularity(model, path),
        largest_joint_speed_share=0.0 if plan.is_standstill else float(shares.max()),
        largest_speed_mm_s=0.0 if plan.is_standstill else float(body.max()),
        nearest_to_head_mm=None if isinf(nearest) else nearest,
    )


def singularity(model: ArmModel, path: SweptPath) -> Singularity:
    """The least distance of a swept path from the singularities."""
    wrist = elbow = shoulder = inf
    for row in path.joints_rad.tolist():
        A1, A2, A3, A4, A5, A6 = row
        wrist = min(wrist, abs(sin(A5)))
        elbow = min(elbow, abs(sin(A3 - model.stretched_A3_rad)))
        shoulder = min(shoulder, abs(_ahead_mm(model, (A1, A2, A3, A4, A5, A6))) / model.reach_mm)
    return Singularity(wrist, elbow, shoulder)


def _ahead_mm(model: ArmModel, joints_rad: JointVector) -> float:
    """Distance of the wrist centre from the axis of A1."""
    _, A2, A3, _, _, _ = joints_rad
    return (
        model.shoulder_offset_mm
        + model.upper_arm_mm * cos(A2)
        + hypot(model.forearm_mm, model.elbow_offset_mm) * cos(A2 + A3 - model.stretched_A3_rad)
    )


def _speeds(path: SweptPath, plan: MotionPlan) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The largest speed of the path parameter in every interval, as limited."""
    limits = np.full(len(path.parameters) - 1, plan.limits.velocity)
    for step in plan.speed_steps:
        limits[path.parameters[:-1] >= step.start - 1e-12] = step.velocity
    return limits
