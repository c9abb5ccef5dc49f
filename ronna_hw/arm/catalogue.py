"""Known arms by their names in calibration records: this package's own, and others by entry point.

A driver package with an arm of its own declares, for example::

    [project.entry-points."ronna_hw.arms"]
    ur5 = "my_package.ur5:Ur5"

The class is called without arguments; the result is the arm's `Kinematics`.
"""

from __future__ import annotations

from importlib.metadata import entry_points

from ronna_hw.arm.errors import UnknownArm
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.kr6_r900 import ArmVariant, kr6_r900

GROUP = "ronna_hw.arms"


def find_kinematics(name: str) -> Kinematics:
    """Find the arm with this `Kinematics.name`; raises ARM-009 with the known names."""
    if name in (own := [str(variant) for variant in ArmVariant]):
        return kr6_r900(name)
    others = {point.name: point for point in entry_points(group=GROUP)}
    if name not in others:
        known = ", ".join(sorted([*own, *others]))
        raise UnknownArm(f"there is no arm named {name!r}", expected=f"one of {known}")
    arm: Kinematics = others[name].load()()
    return arm


def require_known_arm(name: str) -> str:
    """Return the name of a known arm; a validator of models, raises ValueError with the known names."""
    try:
        find_kinematics(name)
    except UnknownArm as error:
        raise ValueError(error.summary) from error
    return name
