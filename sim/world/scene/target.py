"""A planned trajectory in a scene, within the bounds of the plan that is made from it."""

from __future__ import annotations

from math import dist
from typing import Self

from pydantic import Field, model_validator

from ronna_hw.calibration import Numbers3, Strict
from ronna_hw.plausible import LEAST_DEPTH_MM, MOST_DEPTH_MM, FreeAngle, Margin, TrajectoryName


class Target(Strict):
    """A planned trajectory in the CT frame."""

    identifier: TrajectoryName = Field(description="Name of the trajectory.")
    entry_ct_mm: Numbers3 = Field(description="Entry point, CT frame.")
    target_ct_mm: Numbers3 = Field(description="Target point, CT frame.")
    free_angle_deg: FreeAngle = Field(default=0.0, description="Rotation of the guide about the trajectory.")
    margin_mm: Margin = Field(default=2.0, description="Margin stated in the plan.")

    @model_validator(mode="after")
    def _has_a_depth(self) -> Self:
        if not LEAST_DEPTH_MM <= self.depth_mm <= MOST_DEPTH_MM:
            raise ValueError(
                f"entry_ct_mm and target_ct_mm are {self.depth_mm:.3g} mm apart, "
                f"expected {LEAST_DEPTH_MM:g} to {MOST_DEPTH_MM:g} mm"
            )
        return self

    @property
    def depth_mm(self) -> float:
        """Distance from entry to target."""
        return dist(self.entry_ct_mm, self.target_ct_mm)

    @property
    def outwards_ct(self) -> Numbers3:
        """Unit vector from the target towards the entry."""
        x, y, z = ((e - t) / self.depth_mm for e, t in zip(self.entry_ct_mm, self.target_ct_mm, strict=True))
        return (x, y, z)
