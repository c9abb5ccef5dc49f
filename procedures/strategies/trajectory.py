"""A planned straight path into the head: five numbers set by the surgeon, one angle free."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from procedures.strategies.errors import BadTrajectory

Array = NDArray[np.float64]
Point = tuple[float, float, float]

SHORTEST_MM = 1e-3  # below a micrometre the direction is rounding noise


@dataclass(frozen=True)
class Trajectory:
    """Entry and target in CT coordinates (LPS, mm) and the free angle about the axis (rad).

    `beyond_mm` is how far beyond the target, along the axis, the tool origin comes to rest: a guide is held
    outside the head, and its tip frame is at the end of its mandrel. `standoff_mm` is the plan's, from the
    entry to the guide, for messages. Raises STR-003 when entry and target coincide or a number is not finite.
    """

    identifier: str
    entry_mm: Point
    target_mm: Point
    free_angle_rad: float = 0.0
    beyond_mm: float = 0.0
    standoff_mm: float | None = None

    def __post_init__(self) -> None:
        """Check that the trajectory has a direction."""
        numbers = (*self.entry_mm, *self.target_mm, self.free_angle_rad, self.beyond_mm)
        if not all(map(math.isfinite, numbers)):
            raise BadTrajectory(f"trajectory {self.identifier} has a number that is not finite")
        if self.depth_mm < SHORTEST_MM:
            raise BadTrajectory(f"entry and target of trajectory {self.identifier} coincide")

    def held(self, beyond_mm: float, standoff_mm: float | None = None) -> Trajectory:
        """The same trajectory, with the tool at rest this far beyond the target."""
        return replace(self, beyond_mm=beyond_mm, standoff_mm=standoff_mm)

    @property
    def rest_mm(self) -> Array:
        """Rest position of the tool origin (3,), CT coordinates."""
        return np.asarray(np.add(self.target_mm, self.beyond_mm * self.axis_ct))

    @property
    def depth_mm(self) -> float:
        """Distance from entry to target."""
        return math.dist(self.entry_mm, self.target_mm)

    @property
    def axis_ct(self) -> Array:
        """Unit vector (3,) from entry to target, into the head, in CT coordinates."""
        return np.subtract(self.target_mm, self.entry_mm) / self.depth_mm
