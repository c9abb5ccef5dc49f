"""Catalogue of arms by name: the built-in ones and those registered as entry points.

A driver package with an arm of its own declares, for example::

    [project.entry-points."ronna_hw.arms"]
    tx2 = "my_package.tx2:Tx2"

The class is called without arguments; the result is the arm's `Kinematics`.
"""

from __future__ import annotations

from importlib.metadata import entry_points

from ronna_hw.arm.errors import UnknownArm
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.kr6_r900 import ArmVariant, kr6_r900
from ronna_hw.arm.universal_robots import UrModel, universal_robot

GROUP = "ronna_hw.arms"
_ARMS: tuple[Kinematics, ...] = (*map(kr6_r900, ArmVariant), *map(universal_robot, UrModel))
BUILT_IN = {arm.name: arm for arm in _ARMS}
# Of a pose that is reached again, one standard deviation per axis: half of the 0.03 mm that the vendors
# publish; for a UR5 it is 0.1 mm by ISO 9283, a mean and three standard deviations of the distance.
# Safety against a moved head or cart within the arm's own error. Source: data sheets, ISO 9283.
REPEATABILITY_MM = {**{arm.value: 0.015 for arm in ArmVariant}, "ur5": 0.03, "ur5e": 0.015}


def find_kinematics(name: str) -> Kinematics:
    """Look up an arm by its `Kinematics.name`. Raises ARM-009 listing the known names."""
    if name in BUILT_IN:
        return BUILT_IN[name]
    others = {point.name: point for point in entry_points(group=GROUP)}
    if name not in others:
        known = ", ".join(sorted([*BUILT_IN, *others]))
        raise UnknownArm(f"there is no arm named {name!r}", expected=f"one of {known}")
    arm: Kinematics = others[name].load()()
    return arm


def repeatability_mm(name: str) -> float:
    """Return the repeatability of an arm, mm per axis; of another one as of the least repeatable here."""
    return REPEATABILITY_MM.get(name, max(REPEATABILITY_MM.values()))


def require_known_arm(name: str) -> str:
    """Validate that an arm is known and return its name; raises ValueError listing the known names."""
    try:
        find_kinematics(name)
    except UnknownArm as error:
        raise ValueError(error.summary) from error
    return name
