"""How the wrist of the arm stands over the poses of one trajectory: near its singularity, or turned far.

At A5 = 0 the axes of A4 and A6 coincide: small errors of a pose become large turns of both, and what the
joints' own errors do to the tool changes from pose to pose. A registration takes out what is common to the
localizations and the target, so A4 should stand alike at both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

from procedures.planning.visits import PathCheck, VisitKind

LEAST_A5_RAD = math.radians(15.0)  # at 5 deg a target error of 0.69 mm was seen, three times the usual
MOST_A4_CHANGE_RAD = math.radians(45.0)  # between a localization and the target


@dataclass(frozen=True)
class WristState:
    """The least |A5| over all poses and approaches, and the largest change of A4 from target to spheres.

    A whole turn of A4 counts as a change: the arm would have to make it in between.
    """

    least_A5_rad: float
    largest_A4_change_rad: float

    @classmethod
    def of(cls, check: PathCheck) -> Self:
        """Of the poses of one trajectory; the check must have reached its target."""
        least_rad = min(abs(joints[4]) for one in check.reached for joints in (one.approach_rad, one.at_rad))
        targets = [one.at_rad[3] for one in check.reached if one.visit.kind is VisitKind.TARGET]
        spheres = [one.at_rad[3] for one in check.reached if one.visit.kind is VisitKind.LOCALIZATION]
        changes = [abs(target - sphere) for target in targets for sphere in spheres]
        return cls(least_rad, max(changes, default=0.0))

    @property
    def good(self) -> bool:
        """Whether the wrist stays clear of its singularity and stands alike at spheres and target."""
        return self.least_A5_rad >= LEAST_A5_RAD and self.largest_A4_change_rad < MOST_A4_CHANGE_RAD
