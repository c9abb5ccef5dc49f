"""The KR 6 R900 as strategies see it in tests, with guide and stereo head alike."""

from __future__ import annotations

from procedures.strategies.arm_in_branch import ArmInBranch
from ronna_hw.arm.angles import radians6
from ronna_hw.arm.kr6_r900 import ArmVariant, kr6_r900
from ronna_hw.frames import Frame, Transform

HOME_RAD = radians6(0.0, -75.0, 99.0, 0.0, 66.0, 180.0)
TOOL = Transform.of(Frame.FLANGE, Frame.TOOL, translation_mm=(220.0, 0.0, 60.0))
KR6 = kr6_r900(ArmVariant.SIXX)
ARM = ArmInBranch(KR6, TOOL, TOOL, KR6.branch_of(HOME_RAD), HOME_RAD)
