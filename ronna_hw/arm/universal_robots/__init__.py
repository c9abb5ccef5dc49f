"""Kinematics of the Universal Robots UR5 and UR5e, nominal and with the factory's calibration."""

from ronna_hw.arm.universal_robots.geometry import UrModel
from ronna_hw.arm.universal_robots.kinematics import UniversalRobot, universal_robot

__all__ = ["UniversalRobot", "UrModel", "universal_robot"]
