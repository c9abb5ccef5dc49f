"""Closed-form kinematics of both KUKA KR 6 R900 variants: six axes with a spherical wrist."""

from ronna_hw.arm.kr6_r900.geometry import R900_2, SIXX
from ronna_hw.arm.kr6_r900.kinematics import Kr6R900, kr6_r900

__all__ = ["R900_2", "SIXX", "Kr6R900", "kr6_r900"]
