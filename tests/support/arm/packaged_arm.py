"""An arm that a package of its own would bring: a UR5e by another name."""

from __future__ import annotations

from dataclasses import replace

from ronna_hw.arm.catalogue import ArmDescription
from ronna_hw.arm.universal_robots.geometry import DIMENSIONS, UR5E
from ronna_hw.arm.universal_robots.kinematics import UniversalRobot


class PackagedArm(UniversalRobot):
    """Called without arguments, as the catalogue does."""

    def __init__(self) -> None:
        super().__init__(replace(DIMENSIONS[UR5E], name="packaged"))


def describe_packaged_arm() -> ArmDescription:
    """Describe it as well."""
    return ArmDescription(
        kinematics=PackagedArm(),
        make="Packager",
        repeatability_mm=0.02,
        repeatability_source="its data sheet",
    )
