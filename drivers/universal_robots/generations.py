"""Generations of controllers, by the model of arm that they drive."""

from __future__ import annotations

from typing import NamedTuple

from ronna_hw.arm.universal_robots import UR3E, UR5, UR5E, UR10E, UR16E


class Generation(NamedTuple):
    """Generation of controllers. Older software than `least_minor` lacks what the stream needs."""

    text: str
    major: int  # of its software
    least_minor: int
    cycle_s: float
    has_remote_control: bool


E_SERIES = Generation("an e-Series controller", 5, 6, 0.002, has_remote_control=True)
GENERATIONS = {
    UR5: Generation("a CB3 controller", 3, 9, 0.008, has_remote_control=False),  # registers 24 to 47
    **dict.fromkeys((UR5E, UR3E, UR10E, UR16E), E_SERIES),
}


def arm_of_version(major: int) -> str | None:
    """Return the usual model for controllers of this major version, or None for another generation."""
    return next((model for model, one in GENERATIONS.items() if one.major == major), None)
