"""Kinematics of the Universal Robots arms, nominal and with the factory's calibration."""

from ronna_hw.arm.universal_robots.geometry import UR3E, UR5, UR5E, UR10E, UR16E
from ronna_hw.arm.universal_robots.kinematics import UniversalRobot, universal_robot

__all__ = ["UR3E", "UR5", "UR5E", "UR10E", "UR16E", "UniversalRobot", "universal_robot"]
