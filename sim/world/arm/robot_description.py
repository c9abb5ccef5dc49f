"""The KR 6 R900 according to this controller's machine data: joint by joint, millimetres and degrees.

Written from the published robot descriptions of both arms that share the name, independently of the
closed-form model used in the rest of the project.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, degrees
from typing import Literal

Variant = Literal["kr6_r900_sixx", "kr6_r900_2"]
AXES = 6
FLANGE_PITCH_DEG = 90.0  # the flange frame is the last link turned about its y: z points out of the flange


@dataclass(frozen=True)
class Joint:
    """One revolute joint; `origin_mm` is its position in the previous joint's frame."""

    name: str
    origin_mm: tuple[float, float, float]
    axis: tuple[float, float, float]
    lower_deg: float
    upper_deg: float
    full_speed_deg_s: float
    acceleration_deg_s2: float


@dataclass(frozen=True)
class RobotDescription:
    """An arm. `variant` is also the controller's name for it, `model` the content of $ROBTRAFO[]."""

    variant: Variant
    model: str
    joints: tuple[Joint, ...]

    @property
    def stretched_A3_deg(self) -> float:
        """A3 at which upper arm and wrist root are aligned."""
        return degrees(atan2(self.joints[3].origin_mm[2], self.joints[4].origin_mm[0]))


# Planner accelerations published for the sixx in rad/s2; none are published for the -2, so the same are used.
_ACCELERATION = tuple(degrees(value) for value in (21.67, 6.89, 31.42, 133.1, 135.6, 268.4))


def _arm(
    elbow_mm: float, flange_mm: float, wrist_speeds_deg_s: tuple[float, float, float]
) -> tuple[Joint, ...]:
    fourth, fifth, sixth = wrist_speeds_deg_s
    a = _ACCELERATION
    return (
        Joint("A1", (0.0, 0.0, 400.0), (0.0, 0.0, -1.0), -170.0, 170.0, 360.0, a[0]),
        Joint("A2", (25.0, 0.0, 0.0), (0.0, 1.0, 0.0), -190.0, 45.0, 300.0, a[1]),
        Joint("A3", (455.0, 0.0, 0.0), (0.0, 1.0, 0.0), -120.0, 156.0, 360.0, a[2]),
        Joint("A4", (0.0, 0.0, elbow_mm), (-1.0, 0.0, 0.0), -185.0, 185.0, fourth, a[3]),
        Joint("A5", (420.0, 0.0, 0.0), (0.0, 1.0, 0.0), -120.0, 120.0, fifth, a[4]),
        Joint("A6", (flange_mm, 0.0, 0.0), (-1.0, 0.0, 0.0), -350.0, 350.0, sixth, a[5]),
    )


_DESCRIPTIONS: dict[Variant, RobotDescription] = {
    "kr6_r900_sixx": RobotDescription(
        "kr6_r900_sixx", "#KR6R900_C4SR_FLR", _arm(35.0, 80.0, (381.0, 388.0, 615.0))
    ),
    "kr6_r900_2": RobotDescription(
        "kr6_r900_2", "#KR6R900_2_C4SR_FLR", _arm(25.0, 90.0, (450.0, 450.0, 540.0))
    ),
}


def description(variant: Variant) -> RobotDescription:
    """The machine data of a variant."""
    return _DESCRIPTIONS[variant]
