"""The arms whose kinematics are part of this package, by their names in calibration records."""

from __future__ import annotations

from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.kr6_r900 import ArmVariant, kr6_r900


def kinematics_named(name: str) -> Kinematics:
    """The arm with this `Kinematics.name`; raises ValueError."""
    return kr6_r900(ArmVariant(name))
