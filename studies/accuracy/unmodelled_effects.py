"""Effects that the model of the arm lacks, drawn for each arm: gears, compliance, warmth, a bumped flange.

None of them is a parameter of an arm's calibration or a source of the prediction. Sizes are assumed: about
those of the smaller errors of set S, for an arm of this class in poor condition. An effect changes the joint
angles at a pose, or displaces the flange, depending on the time in motion since the case began.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Self

import numpy as np

from ronna_hw.arm.kinematics import Chain
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import JOINT_OFFSET_RAD, PER_JOINT, error_columns
from studies.accuracy.random_arms import RandomArms

EFFECT_KEY = 11  # of the random numbers
AXES = 6
# Of a gear, beyond the two harmonics that a calibration knows: of its bearings and teeth.
GEAR_ORDERS = (3, 5, 8, 100)
GEAR_RAD = math.radians(0.008)  # as the second harmonic of set S
# A joint gives way in proportion to the load's moment about it: by this much with the load one lever away.
COMPLIANCE_RAD = math.radians(0.03)  # as the sag of set S
LEVERS_MM = np.array([600.0, 600.0, 400.0, 220.0, 220.0, 220.0])
UNEVEN = 0.5  # share by which its stiffness varies over a turn
# Of the flange's drift when the arm is warm, and of a bump: as often in each octave, since small ones are as
# telling as large ones: a case refuses what it sees, and only what it does not see reaches a target.
SHIFTS_MM = (0.03, 0.5)
WARM_RAD = math.radians(0.005)  # of each joint
WARM_S = 1200.0  # of motion, until two thirds of the drift is reached: that of the simulated arm


class Effect(StrEnum):
    """Effect that the model of the arm lacks."""

    NOTHING = "nothing"
    GEARS = "gear errors of higher order"
    COMPLIANCE = "compliance of all joints"
    WARMTH = "thermal drift within the case"
    BUMP_BEFORE = "flange bumped after the calibration"
    BUMP_DURING = "flange bumped between two spheres"
    BUMP_AFTER = "flange bumped after the localization"


BUMPS = (Effect.BUMP_BEFORE, Effect.BUMP_DURING, Effect.BUMP_AFTER)


@dataclass(frozen=True)
class DisplacedArms(RandomArms):
    """Random arms at planned poses, with joint angles and tools displaced at each: (p, 6) rad, (p, 3) mm."""

    shift_rad: Array = field(default_factory=lambda: np.zeros((1, AXES)))
    shift_mm: Array = field(default_factory=lambda: np.zeros((1, 3)))

    @classmethod
    def at(cls, arms: RandomArms, shift_rad: Array, shift_mm: Array) -> Self:
        """Place arms at poses with these displacements."""
        return cls(**vars(arms) | {"shift_rad": shift_rad, "shift_mm": shift_mm})

    def tool_points_mm(self, joints_rad: Array, flanks: Array) -> Array:
        """Return true tool positions (a, p, 3) in mm, robot frame, without the repeatability error."""
        return super().tool_points_mm(joints_rad + self.shift_rad, flanks) + self.shift_mm


@dataclass(frozen=True)
class DrawnEffect:
    """One arm's effect. Amplitudes are 0 for those that it does not have."""

    gears_rad: Array  # (orders, 6)
    phases_rad: Array  # (orders + 1, 6), the last one of the stiffness
    compliance_rad: Array  # (6,)
    warm_mm: Array  # (3,) robot frame
    warm_rad: Array  # (6,)
    bump_mm: Array  # (3,) frame of the flange

    @classmethod
    def draw(cls, effect: Effect, seed: int, number: int) -> Self:
        random = np.random.default_rng(np.random.SeedSequence([seed, EFFECT_KEY, number]))
        orders = len(GEAR_ORDERS)
        return cls(
            GEAR_RAD * random.normal(size=(orders, AXES)) * (effect is Effect.GEARS),
            random.uniform(0.0, 2.0 * math.pi, (orders + 1, AXES)),
            COMPLIANCE_RAD * np.abs(random.normal(size=AXES)) * (effect is Effect.COMPLIANCE),
            _draw_shift_mm(random) * (effect is Effect.WARMTH),
            WARM_RAD * random.normal(size=AXES) * (effect is Effect.WARMTH),
            _draw_shift_mm(random) * (effect in BUMPS),
        )

    def shift_rad(self, chain: Chain, joints_rad: Array, points_mm: Array, moved_s: Array) -> Array:
        """Return the joint errors (p, 6) at joints (p, 6) with the tool at (p, 3) mm, after this motion."""
        return self.shift_by_load_rad(joints_rad, load_levers(chain, joints_rad, points_mm), moved_s)

    def shift_by_load_rad(self, joints_rad: Array, levers: Array, moved_s: Array) -> Array:
        """Return the joint errors (p, 6) with the load's levers (p, 6), which are the same for all arms."""
        shift = np.zeros_like(joints_rad)
        for amplitude, phase, order in zip(self.gears_rad, self.phases_rad, GEAR_ORDERS, strict=False):
            shift = shift + amplitude * np.sin(order * joints_rad + phase)
        uneven = 1.0 + UNEVEN * np.sin(joints_rad + self.phases_rad[-1])
        shift = shift - self.compliance_rad * uneven * levers
        return np.asarray(shift + self.warm_rad * warmth(moved_s)[:, None])

    def shift_mm(self, moved_s: Array) -> Array:
        """Return the drift (p, 3) of the flange in the robot frame, mm, after this motion."""
        return np.asarray(warmth(moved_s)[:, None] * self.warm_mm)


def load_levers(chain: Chain, joints_rad: Array, points_mm: Array) -> Array:
    """Return the lever (p, 6) of a load at (p, 3) mm about each joint, by that of full compliance.

    A weight does work by the height that a joint moves it, so its moment is that component.
    """
    swings = error_columns(chain, joints_rad, points_mm)[..., ::PER_JOINT] / JOINT_OFFSET_RAD
    return np.asarray(swings[:, 2] / LEVERS_MM)


def _draw_shift_mm(random: np.random.Generator) -> Array:
    direction = random.normal(size=3)
    length_mm = math.exp(random.uniform(*np.log(SHIFTS_MM)))
    return np.asarray(length_mm * direction / np.linalg.norm(direction))


def warmth(moved_s: Array) -> Array:
    """Return the share of the drift reached after this time in motion."""
    return np.asarray(1.0 - np.exp(-np.asarray(moved_s) / WARM_S))
