"""Nominal arms by name, whoever made them."""

from __future__ import annotations

from sim.world import nominal_arm, universal_robots_arm
from sim.world.nominal_arm import RobotDescription

DESCRIPTIONS: dict[str, RobotDescription] = {
    **nominal_arm.DESCRIPTIONS,
    **universal_robots_arm.DESCRIPTIONS,
}
