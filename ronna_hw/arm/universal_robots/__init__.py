"""Kinematics of the Universal Robots UR5 and UR5e, nominal and with the factory's calibration."""

from ronna_hw.arm.universal_robots.geometry import UR5, UR5E
from ronna_hw.arm.universal_robots.kinematics import UniversalRobot, universal_robot

__all__ = ["UR5", "UR5E", "UniversalRobot", "universal_robot"]
