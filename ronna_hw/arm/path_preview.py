"""Numeric preview of a planned path for display, records and JSON, made by `ronna_hw.preview`."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from ronna_hw.arm.clearance.sweep import ClosestPair
from ronna_hw.arm.kinematics import SingularMeasure


@dataclass(frozen=True)
class PathPreview:
    """Numeric preview of a planned path. Angles in rad; `largest_speed_mm_s` covers all moving bodies."""

    duration_s: float
    joint_ranges_rad: tuple[tuple[float, float], ...]
    closest: ClosestPair | None
    refused: ClosestPair | None
    singularity: SingularMeasure
    largest_joint_speed_share: float  # of the limits of the motion
    largest_speed_mm_s: float
    nearest_to_head_mm: float | None

    @property
    def clear(self) -> bool:
        """Whether every body keeps its minimum distance from the others."""
        return self.refused is None

    def as_payload(self) -> dict[str, Any]:
        """Return plain numbers for records and JSON."""
        closest: dict[str, Any] | None = None
        if self.closest is not None:
            closest = asdict(self.closest)
            closest["at"] = closest.pop("fraction")
        return {
            "duration_s": self.duration_s,
            "joint_ranges_rad": [list(limits) for limits in self.joint_ranges_rad],
            "clear": self.clear,
            "closest": closest,
            "singularity": self.singularity._asdict(),
            "largest_joint_speed_share": self.largest_joint_speed_share,
            "largest_speed_mm_s": self.largest_speed_mm_s,
            "nearest_to_head_mm": self.nearest_to_head_mm,
        }
