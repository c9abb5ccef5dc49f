"""Nominal arms by name, whoever made them, and their closed-form inverse."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

from sim.world import nominal_arm, universal_robots_arm
from sim.world.nominal_arm import RobotDescription
from sim.world.rigid import Matrix

DESCRIPTIONS: dict[str, RobotDescription] = {
    **nominal_arm.DESCRIPTIONS,
    **universal_robots_arm.DESCRIPTIONS,
}


class Inverse(NamedTuple):
    """Inverse of an arm in closed form, in the postures of a procedure, the usual one first.

    `axes` gives the joint angles (rad, modulo whole turns) for a flange pose (4, 4) in the robot's base in
    one of the postures, or None out of reach; the ends of the joints' ranges are not checked.
    """

    postures: tuple[int, ...]
    axes: Callable[[RobotDescription, Matrix, int], Sequence[float] | None]


KUKA = Inverse(nominal_arm.POSTURES, nominal_arm.axes_of_status)
UNIVERSAL_ROBOTS = Inverse(universal_robots_arm.POSTURES, universal_robots_arm.axes_of_branch)
INVERSES: dict[str, Inverse] = {
    **dict.fromkeys(nominal_arm.DESCRIPTIONS, KUKA),
    **dict.fromkeys(universal_robots_arm.DESCRIPTIONS, UNIVERSAL_ROBOTS),
}
