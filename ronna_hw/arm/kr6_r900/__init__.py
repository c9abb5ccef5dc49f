"""Closed-form kinematics of both KUKA KR 6 R900 variants: six axes with a spherical wrist."""

from ronna_hw.arm.kr6_r900.geometry import ArmVariant
from ronna_hw.arm.kr6_r900.kinematics import Kr6R900, kr6_r900

__all__ = ["ArmVariant", "Kr6R900", "kr6_r900"]
