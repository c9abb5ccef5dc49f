"""An arm that a package of its own would bring: a UR5e by another name."""

from __future__ import annotations

from dataclasses import replace

from ronna_hw.arm.universal_robots.geometry import DIMENSIONS, UrModel
from ronna_hw.arm.universal_robots.kinematics import UniversalRobot


class PackagedArm(UniversalRobot):
    """Called without arguments, as the catalogue does."""

    def __init__(self) -> None:
        super().__init__(replace(DIMENSIONS[UrModel.UR5E], name="packaged"))
