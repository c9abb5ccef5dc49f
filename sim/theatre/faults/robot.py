"""Faults of the robot's controller and of its links."""

from __future__ import annotations

from sim.theatre.faults.kinds import FaultKind, at_most_all

ROBOT_FAULTS = (
    FaultKind(
        "drop", "robot", "drop NUMBER %", "That share of the RSI replies never arrives.", check=at_most_all
    ),
)
