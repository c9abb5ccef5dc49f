"""Six-axis force sensor between the flange of an arm and its holder, with errors of its own.

Its electronics subtract the weight of the holder; what is left of it is in the bias. What is drawn for a
sensor does not depend on when it is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import numpy as np

from sim.world.drilling import NO_SIDE, DrilledSkull
from sim.world.held_torques import GRAVITY_M_S2
from sim.world.noise import TabledNoise, noise
from sim.world.options import ArmRole
from sim.world.rigid import Array, matrix_of
from sim.world.world import World

NO_FORCES: Final[Sequence[float]] = (0.0,) * 6
NO_WRENCH: Final = np.zeros(6)
MM: Final = 1000.0
SECONDS_PER_MINUTE: Final = 60.0
DEVICE: Final = "force sensor"  # noise key


class ForceSensor:
    """Force sensor of the arm in a role."""

    def __init__(self, world: World, role: ArmRole) -> None:
        """Draw the sensor's errors. Raises KeyError for an arm without one."""
        holder = world.scene.holders[role]
        assert holder.force_sensor is not None, "there is a sensor"
        self._world, self._role = world, role
        self._clock, self._skull = world.clock, DrilledSkull(world, role)
        self._robot_from_base = matrix_of(holder.robot_from_base)[:3, :3]
        clamp = matrix_of(holder.flange_from_clamp)
        axis, place_m = clamp[:3, 2], clamp[:3, 3] / MM
        self._clamp_m = place_m
        self._along = -np.array([*axis, *np.cross(place_m, axis)])  # of each newton against the drill
        self._across = np.array([[*side, *np.cross(place_m, side)] for side in clamp[:3, :2].T])
        truth, draws = holder.force_sensor, noise(world.scene.seed, f"{DEVICE} {role.value}", 0)
        gains = 1.0 + draws.normal(0.0, truth.gain_share, 6)
        crosstalk = draws.normal(0.0, truth.crosstalk_share, (6, 6)) * (1.0 - np.eye(6))
        self._shows = truth.scale * (np.diag(gains) + crosstalk)
        units = np.array([1.0] * 3 + [truth.noise_Nm / truth.noise_N if truth.noise_N else 0.0] * 3)
        self._bias = draws.normal(0.0, truth.bias_N, 6) * units
        self._drift_s = draws.normal(0.0, truth.drift_N_min / SECONDS_PER_MINUTE, 6) * units
        self._sizes = truth.noise_N * units
        self._noise = TabledNoise(world.scene.seed, f"{DEVICE} {role.value}")
        self._last: Sequence[float] = NO_FORCES

    def read(self, cycle: int, *, is_dead: bool = False) -> Sequence[float]:
        """Return what it states in a cycle: forces (N) and torques (Nm) along the axes of the flange."""
        thrust_N = self._skull.thrust_N()
        if not is_dead:
            drifted = self._bias + self._clock.now_s() * self._drift_s
            shown = (
                self._shows @ (thrust_N * self._along + self._side_force() + self._hung_weight()) + drifted
            )
            self._last = (shown + self._sizes * self._noise.at(cycle, 6)).tolist()
        return self._last

    def _side_force(self) -> Array:
        """Return force and torque (6,) across the drill, as if at the clamp, along the axes of the flange."""
        side_N = self._skull.side_N
        return NO_WRENCH if side_N == NO_SIDE else np.array(side_N) @ self._across

    def _hung_weight(self) -> Array:
        """Return force and torque (6,) of the test weight on the clamp, along the axes of the flange."""
        if not (mass_kg := self._world.hung_kg()):
            return NO_WRENCH
        robot_from_flange = self._robot_from_base @ self._world.arm(self._role).robot_from_flange[:3, :3]
        weight_N = -GRAVITY_M_S2 * mass_kg * robot_from_flange[2]
        return np.array([*weight_N, *np.cross(self._clamp_m, weight_N)])


def sensor_of(world: World, role: ArmRole) -> ForceSensor | None:
    """Return the sensor on the flange of the arm in a role, or None without one."""
    holder = world.scene.holders.get(role)
    return None if holder is None or holder.force_sensor is None else ForceSensor(world, role)
