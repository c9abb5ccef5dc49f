"""Effects that the model of the arm lacks: gears, compliance, warmth, a bumped flange, a moved sphere.

None of them is a parameter of an arm's calibration or a source of the prediction. An effect changes the joint
angles at a pose, or displaces the flange, depending on the time in motion since the case began. Sizes are
published ones of small arms and of the gears in them. Which gears the KR 6 R900 has is not published: strain
wave gears of usual sizes are assumed. How far a flange is bumped, or a sphere moved, no publication says.
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
# Orders of a gear's error beyond the two that a calibration knows: of bearings, and twice per turn of the
# wave generator at a ratio of 100 (Tuttle 1992, Understanding and modeling the behavior of a harmonic drive).
GEAR_ORDERS = (3, 5, 8, 200)
# Transmission accuracy of gears of sizes 32, 32, 25, 17, 17 and 14, peak to peak over one turn of the output
# (Harmonic Drive, CSF and CSG series, positioning accuracy, ratios from 50). It is a maker's limit, and here
# all of it is in these orders.
TRANSMISSION_RAD = np.radians(np.array([1.0, 1.0, 1.0, 1.5, 1.5, 1.5]) / 60.0)
# Torsional stiffness K2 of the same gears, ratios from 80 (same source). The moment about a joint that the
# calibration's sag does not know: that of the rated load of the KR 6 R900, one lever away.
STIFFNESS_NM = np.array([11e4, 11e4, 5.0e4, 1.4e4, 1.4e4, 0.61e4])
LEVERS_MM = np.array([600.0, 600.0, 400.0, 220.0, 220.0, 220.0])
LOAD_N = 3.0 * 9.81
COMPLIANCE_RAD = LOAD_N * LEVERS_MM / 1000.0 / STIFFNESS_NM
UNEVEN = 0.25  # share by which a stiffness varies over a turn, as K1 and K3 differ from K2
# Sizes as often in each octave, since small ones are as telling as large ones: a case refuses what it sees,
# and only what it does not see reaches a target. The drift of the flange when the arm is warm: up to ten
# times the 0.025 mm of repeatability of arms for up to 10 kg (Influence of drift on robot repeatability and
# its compensation, Applied Sciences 2021, 11, 10813); the maker of the R12 arm states less than 0.2 mm.
DRIFTS_MM = (0.025, 0.25)
WARM_RAD = math.radians(0.002)  # of each joint (assumed)
WARM_S = 1200.0  # of motion, until two thirds of the drift is reached: that of the simulated arm
SHIFTS_MM = (0.03, 0.5)  # of a bumped flange (assumed)
MOVED_MM = (0.05, 2.0)  # of a sphere (assumed)


class Effect(StrEnum):
    """Effect that the model of the arm lacks."""

    NOTHING = "nothing"
    GEARS = "gear errors of higher order"
    COMPLIANCE = "compliance of all joints"
    WARMTH = "thermal drift within the case"
    BUMP_BEFORE = "flange bumped after the calibration"
    BUMP_DURING = "flange bumped between two spheres"
    BUMP_AFTER = "flange bumped after the localization"
    SPHERE_MOVED = "sphere moved since the CT"


BUMPS = (Effect.BUMP_BEFORE, Effect.BUMP_DURING, Effect.BUMP_AFTER)
AFTER_CALIBRATION = (*BUMPS, Effect.SPHERE_MOVED)


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
    moved_mm: Array  # (3,) of the first sphere, robot frame

    @classmethod
    def draw(cls, effect: Effect, seed: int, number: int) -> Self:
        random = np.random.default_rng(np.random.SeedSequence([seed, EFFECT_KEY, number]))
        orders = len(GEAR_ORDERS)
        shares = np.abs(random.normal(size=(orders, AXES)))  # the amplitudes add up to half from peak to peak
        return cls(
            0.5 * TRANSMISSION_RAD * shares / shares.sum(axis=0) * (effect is Effect.GEARS),
            random.uniform(0.0, 2.0 * math.pi, (orders + 1, AXES)),
            COMPLIANCE_RAD * np.abs(random.normal(size=AXES)) * (effect is Effect.COMPLIANCE),
            _draw_shift_mm(random, DRIFTS_MM) * (effect is Effect.WARMTH),
            WARM_RAD * random.normal(size=AXES) * (effect is Effect.WARMTH),
            _draw_shift_mm(random, SHIFTS_MM) * (effect in BUMPS),
            _draw_shift_mm(random, MOVED_MM) * (effect is Effect.SPHERE_MOVED),
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


def _draw_shift_mm(random: np.random.Generator, sizes_mm: tuple[float, float]) -> Array:
    direction = random.normal(size=3)
    length_mm = math.exp(random.uniform(*np.log(sizes_mm)))
    return np.asarray(length_mm * direction / np.linalg.norm(direction))


def warmth(moved_s: Array) -> Array:
    """Return the share of the drift reached after this time in motion."""
    return np.asarray(1.0 - np.exp(-np.asarray(moved_s) / WARM_S))
