"""Torques that a true arm holds at rest: the weight of links and tool, a hand on the tool, and stiction.

The arm stands upright on its cart.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from sim.world.descriptions import DESCRIPTIONS
from sim.world.noise import noise
from sim.world.nominal_arm import AXES, LinkWeight
from sim.world.scene.model import LinkError
from sim.world.true_arm import build_model

GRAVITY_M_S2 = 9.81
MM = 1000.0
STICTION = "stiction"  # noise key
NO_INERTIA = np.zeros((3, 3))


class HeldTorques:
    """Static torques of one arm. One object belongs to one thread, as Pinocchio's data does."""

    def __init__(
        self, variant: str, bodies: Sequence[LinkWeight], links: Sequence[LinkError] | None = None
    ) -> None:
        """Describe an arm, with the errors of its links or as drawn."""
        shared, self._flange = build_model(DESCRIPTIONS[variant], None if links is None else tuple(links))
        self._model = model = shared.copy()
        self._data = model.createData()
        model.gravity.linear = np.array([0.0, 0.0, -GRAVITY_M_S2])
        pin.forwardKinematics(model, self._data, np.zeros(AXES))
        for number, (mass_kg, centre_mm) in enumerate(bodies, 1):
            lever_mm = np.array(centre_mm) - self._data.oMi[number].translation
            model.inertias[number] = pin.Inertia(mass_kg, lever_mm, NO_INERTIA)
        self._last_link = model.inertias[AXES].copy()
        self._flange_in_link = model.frames[self._flange].placement
        self._load: tuple[float, Sequence[float]] = (0.0, ())
        self._q = np.zeros(AXES)

    def carry(self, mass_kg: float, centre_mm: Sequence[float]) -> None:
        """Carry a load from now on, its centre in the frame of the flange."""
        if (mass_kg, centre_mm) != self._load:
            self._load = mass_kg, centre_mm
            lever_mm = self._flange_in_link.act(np.array(centre_mm, dtype=float))
            load = pin.Inertia(mass_kg, lever_mm, NO_INERTIA)
            self._model.inertias[AXES] = self._last_link + load

    def weight_Nm(self, joints_rad: Sequence[float]) -> list[float]:
        """Return the torques against gravity. Lengths are in mm, hence the factor."""
        self._q[:] = joints_rad
        torques = pin.computeGeneralizedGravity(self._model, self._data, self._q) / MM
        return [float(torque) for torque in torques]

    def against_force_Nm(
        self, joints_rad: Sequence[float], force_N: Sequence[float], point_mm: Sequence[float]
    ) -> list[float]:
        """Return the torques against a force of the room, in the base, at a point of the flange frame."""
        self._q[:] = joints_rad
        jacobian = pin.computeFrameJacobian(
            self._model, self._data, self._q, self._flange, pin.LOCAL_WORLD_ALIGNED
        )
        place = self._data.oMf[self._flange]
        force = np.array(force_N, dtype=float)
        moment_N_mm = np.cross(place.rotation @ np.array(point_mm), force)
        torques = -(jacobian[:3].T @ force + jacobian[3:].T @ moment_N_mm) / MM
        return [float(torque) for torque in torques]


class Stiction:
    """Friction of the gears: motors need not hold what it holds, up to a limit, and nobody knows which way.

    In motion it is against that. Where it stays when an arm comes to rest differs from stop to stop. A load
    that comes later shows only by what exceeds it.
    """

    def __init__(self, limits_Nm: Sequence[float], seed: int) -> None:
        self._limits_Nm, self._seed = tuple(limits_Nm), seed
        self._motors_Nm: list[float] = []  # at rest
        self._stop: int | None = None

    def at_rest(self, held_Nm: Sequence[float], stop: int) -> list[float]:
        """Return what the motors hold at the stop with this number."""
        if stop != self._stop:
            self._stop = stop
            shares = noise(self._seed, STICTION, stop).uniform(-1.0, 1.0, AXES).tolist()
            self._motors_Nm = [
                held + share * limit
                for held, share, limit in zip(held_Nm, shares, self._limits_Nm, strict=True)
            ]
        self._motors_Nm = [
            min(max(motor, held - limit), held + limit)
            for motor, held, limit in zip(self._motors_Nm, held_Nm, self._limits_Nm, strict=True)
        ]
        return self._motors_Nm

    def moving(self, held_Nm: Sequence[float], directions: Sequence[float]) -> list[float]:
        """Return what the motors hold in motion, with each joint's direction from -1 to 1."""
        self._stop = None
        return [
            held + way * limit for held, way, limit in zip(held_Nm, directions, self._limits_Nm, strict=True)
        ]
