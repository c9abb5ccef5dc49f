"""Catalogue of arms by name: the built-in ones and those registered as entry points.

A driver package with an arm of its own declares, for example::

    [project.entry-points."ronna_hw.arms"]
    tx2 = "my_package.tx2:Tx2"

The class is called without arguments; the result is the arm's `ArmDescription`, or its `Kinematics` alone.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from enum import StrEnum

from ronna_hw.arm import load_model
from ronna_hw.arm.errors import UnknownArm
from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.kr6_r900 import R900_2, SIXX, kr6_r900
from ronna_hw.arm.load_model import LoadModel
from ronna_hw.arm.universal_robots import UR3E, UR5, UR5E, UR10E, UR16E, universal_robot
from ronna_hw.near_names import did_you_mean

GROUP = "ronna_hw.arms"
KUKA, UNIVERSAL_ROBOTS = "KUKA", "Universal Robots"  # makes
DRIVERS: Mapping[str, str] = {KUKA: "kuka_rsi", UNIVERSAL_ROBOTS: "universal_robots"}  # by make


class ArmChoice(StrEnum):
    """Arm of a simulated theatre, as a command line names it."""

    KR6 = "kr6"
    UR5 = "ur5"
    UR5E = "ur5e"


@dataclass(frozen=True, kw_only=True)
class ArmDescription:
    """Model of an arm: kinematics, which has axes, home and bodies, make, repeatability and load model."""

    kinematics: Kinematics
    make: str = ""
    reported_as: str = ""  # by its controller
    choice: ArmChoice | None = None  # None: no scene is drawn with it
    repeatability_mm: float  # of a pose that is reached again, one standard deviation per axis
    repeatability_source: str
    load: LoadModel | None = None  # None: no load is estimated from the signals of its controller

    @property
    def name(self) -> str:
        """Name of the arm, as used in calibration records."""
        return self.kinematics.name


# Of a pose that is reached again, one standard deviation per axis: of a KR6, a UR5e and a UR3e, of a UR5, and
# of a UR10e or UR16e.
# Safety against a moved head or cart within the arm's own error. Source: data sheets, ISO 9283.
REPEATABILITY_MM, UR5_REPEATABILITY_MM = 0.015, 0.03
UR10E_REPEATABILITY_MM = 0.025

HALF_OF_PUBLISHED = "half of the 0.03 mm that the vendor publishes by ISO 9283 (U)"
_KR6 = ArmDescription(
    kinematics=kr6_r900(SIXX),
    make=KUKA,
    reported_as=SIXX,  # by our program on the controller
    choice=ArmChoice.KR6,
    repeatability_mm=REPEATABILITY_MM,
    repeatability_source=HALF_OF_PUBLISHED,
    load=load_model.KR6,
)
_UR5E = ArmDescription(
    kinematics=universal_robot(UR5E),
    make=UNIVERSAL_ROBOTS,
    reported_as="UR5",  # by the dashboard of both generations
    choice=ArmChoice.UR5E,
    repeatability_mm=REPEATABILITY_MM,
    repeatability_source=HALF_OF_PUBLISHED,
    load=load_model.UR5E,
)


def _size_of_ur5e(name: str, reported_as: str, repeatability_mm: float, source: str) -> ArmDescription:
    """Describe another size of the e-Series, with which no scene is drawn and whose loads are not known."""
    return replace(
        _UR5E,
        kinematics=universal_robot(name),
        reported_as=reported_as,
        choice=None,
        repeatability_mm=repeatability_mm,
        repeatability_source=source,
        load=None,
    )


ARMS: Mapping[str, ArmDescription] = {
    arm.name: arm
    for arm in (
        _KR6,
        replace(_KR6, kinematics=kr6_r900(R900_2), reported_as=R900_2, choice=None),
        replace(
            _UR5E,
            kinematics=universal_robot(UR5),
            choice=ArmChoice.UR5,
            repeatability_mm=UR5_REPEATABILITY_MM,
            repeatability_source="0.1 mm by ISO 9283: a mean and three standard deviations of the distance",
            load=load_model.UR5,
        ),
        _UR5E,
        _size_of_ur5e(UR3E, "UR3", REPEATABILITY_MM, HALF_OF_PUBLISHED),
        _size_of_ur5e(UR10E, "UR10", UR10E_REPEATABILITY_MM, "half of the 0.05 mm that it publishes (U)"),
        _size_of_ur5e(UR16E, "UR16", UR10E_REPEATABILITY_MM, "half of the 0.05 mm that it publishes (U)"),
    )
}


def list_drivers(choices: Collection[str]) -> tuple[str, ...]:
    """Return the drivers of the arms that these words of a command line choose, each once."""
    return tuple(dict.fromkeys(DRIVERS[arm.make] for arm in ARMS.values() if arm.choice in choices))


def find_arm(name: str) -> ArmDescription:
    """Look up an arm by its `Kinematics.name`. Raises ARM-009 listing the known names."""
    return ARMS[name] if name in ARMS else _find_packaged(name)


def _find_packaged(name: str) -> ArmDescription:
    from importlib.metadata import entry_points  # on demand: commands that only list the choices start faster

    others = {point.name: point for point in entry_points(group=GROUP)}
    if name not in others:
        known = ", ".join(sorted([*ARMS, *others]))
        near = did_you_mean(name, [*ARMS, *others])
        raise UnknownArm(
            f"there is no arm named {name!r}",
            expected=f"one of {known}",
            action=f"{near} {UnknownArm.action}".strip(),
        )
    arm: ArmDescription | Kinematics = others[name].load()()
    return arm if isinstance(arm, ArmDescription) else _describe(arm)


def require_known_arm(name: str) -> str:
    """Validate that an arm is known and return its name; raises ValueError listing the known names."""
    try:
        find_arm(name)
    except UnknownArm as error:
        raise ValueError(error.summary) from error
    return name


def _describe(kinematics: Kinematics) -> ArmDescription:
    """Describe an arm of which a package brings the kinematics alone."""
    return ArmDescription(
        kinematics=kinematics,
        repeatability_mm=max(arm.repeatability_mm for arm in ARMS.values()),
        repeatability_source="that of the least repeatable arm here, assumed",
    )
