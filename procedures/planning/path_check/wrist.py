"""The wrist over the poses of one trajectory: distance from its singularity, and how far it turns.

Near the singularity small pose errors become large turns of two joints, and the effect of the joints' own
errors on the tool varies from pose to pose. Registration removes what localizations and target have in
common, so the wrist should have the same configuration at both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

from procedures.planning.path_check.visits import PathCheck, VisitKind
from ronna_hw.arm.kinematics import Kinematics

LEAST_BEND_RAD = math.radians(15.0)  # at 5 deg a target error of 0.69 mm was observed, three times the usual
MOST_TURN_CHANGE_RAD = math.radians(45.0)  # between a localization and the target


@dataclass(frozen=True)
class WristState:
    """The least bend of the wrist over all poses and approaches, and its turn from target to spheres.

    A whole turn counts as a change: the arm would have to make it in between.
    """

    least_bend_rad: float
    largest_turn_change_rad: float

    @classmethod
    def of(cls, kinematics: Kinematics, check: PathCheck) -> Self:
        """For the poses of one trajectory; the check must have reached its target."""
        turns: dict[VisitKind, list[float]] = {kind: [] for kind in VisitKind}
        for one in check.reached:
            turns[one.visit.kind].append(kinematics.wrist_turn_rad(one.at_rad))
        changes = [
            abs(target - sphere)
            for target in turns[VisitKind.TARGET]
            for sphere in turns[VisitKind.LOCALIZATION]
        ]
        bends = [
            kinematics.wrist_bend_rad(joints)
            for one in check.reached
            for joints in (one.approach_rad, one.at_rad)
        ]
        return cls(min(bends), max(changes, default=0.0))

    @property
    def good(self) -> bool:
        """Whether the wrist is clear of its singularity, in the same configuration at spheres and target."""
        return self.least_bend_rad >= LEAST_BEND_RAD and self.largest_turn_change_rad < MOST_TURN_CHANGE_RAD
