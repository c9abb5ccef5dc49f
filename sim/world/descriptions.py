"""Simulated arms by name, whoever makes them, and their makes by the word for them in fault scripts."""

from __future__ import annotations

from sim.world import nominal_arm, universal_robots_arm

DESCRIPTIONS = {**nominal_arm.DESCRIPTIONS, **universal_robots_arm.DESCRIPTIONS}
MAKES = {arm.make.in_faults: arm.make for arm in DESCRIPTIONS.values()}
