"""Motor currents of the six axes, in percent of the largest of each drive, as RSI states them (MACur).

The currents hold links, tool and a hand on it, as far as the gears do not. Gears and motors are estimates
(U): KUKA publishes neither. A drive states a new current every 12 ms (U).
"""

from __future__ import annotations

from collections.abc import Sequence
from math import radians
from typing import Final

from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.drives import Drives
from sim.world.descriptions import DESCRIPTIONS
from sim.world.displacements import STILL
from sim.world.held_torques import HeldTorques, Stiction
from sim.world.noise import TabledNoise, noise
from sim.world.nominal_arm import AXES
from sim.world.scene.parts import CENTRE_OF_GRAVITY_MM
from sim.world.tool_load import SimulatedLoad
from sim.world.true_arm import arm_seed
from sim.world.world import World

GEAR_RATIOS: Final = (100.0, 120.0, 100.0, 80.0, 80.0, 50.0)
TORQUE_CONSTANTS_NM_A: Final = (0.35, 0.45, 0.35, 0.2, 0.2, 0.2)
LARGEST_CURRENTS_A: Final = (7.0, 6.5, 5.0, 2.2, 2.2, 2.0)
LARGEST_TORQUES_NM: Final = tuple(
    ratio * constant * current
    for ratio, constant, current in zip(GEAR_RATIOS, TORQUE_CONSTANTS_NM_A, LARGEST_CURRENTS_A, strict=True)
)
DEVICE: Final = "motor currents"  # noise key
PERCENT: Final = 100.0


class MotorCurrents:
    """Currents of one arm in a world."""

    def __init__(self, world: World, drives: Drives, parameters: ControllerParameters) -> None:
        truth, seed = world.scene.arm_of(world.role), arm_seed(world.scene.seed, world.role)
        self._drives, self._load = drives, SimulatedLoad(world)
        self._torques = HeldTorques(truth.variant, DESCRIPTIONS[truth.variant].links, truth.links)
        self._stiction = Stiction([parameters.stiction_share * most for most in LARGEST_TORQUES_NM], seed)
        errors = noise(seed, DEVICE, 0).normal(0.0, parameters.current_error_share, AXES).tolist()
        self._percent_per_Nm = [
            (1.0 + error) * PERCENT / most for error, most in zip(errors, LARGEST_TORQUES_NM, strict=True)
        ]
        self._noise, self._noise_percent = TabledNoise(seed, DEVICE), parameters.current_noise_percent
        self._every = parameters.current_cycles
        self._held_at: tuple[object, ...] = ()
        self._held_Nm: Sequence[float] = ()
        self._stated: list[float] = [0.0] * AXES

    def at(self, cycle: int) -> list[float]:
        """Return the currents that a cycle's telegram states, in percent."""
        if cycle % self._every == 0 or not self._held_Nm:
            drives, held_Nm = self._drives, self._hold()
            if drives.at_rest:
                motors_Nm = self._stiction.at_rest(held_Nm, drives.motion_number)
            else:
                motors_Nm = self._stiction.moving(held_Nm, drives.flanks)
            size = self._noise_percent
            self._stated = [
                scale * motor + size * one
                for scale, motor, one in zip(
                    self._percent_per_Nm, motors_Nm, self._noise.at(cycle, AXES), strict=True
                )
            ]
        return self._stated

    def _hold(self) -> Sequence[float]:
        """Return the torques that the joints hold, computed when something has changed."""
        axes_deg, mass_kg, push_N = self._drives.axes_deg, self._load.mass_kg(), self._load.push_N()
        before = self._held_at
        if not before or before[0] is not axes_deg or before[1:] != (mass_kg, push_N):
            self._held_at = axes_deg, mass_kg, push_N
            joints_rad = [radians(angle) for angle in axes_deg]
            self._torques.carry(mass_kg, CENTRE_OF_GRAVITY_MM)
            self._held_Nm = self._torques.weight_Nm(joints_rad)
            if push_N is not STILL:
                against = self._torques.against_force_Nm(joints_rad, push_N, self._load.point_mm)
                self._held_Nm = [a + b for a, b in zip(self._held_Nm, against, strict=True)]
        return self._held_Nm
