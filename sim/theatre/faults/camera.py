"""Faults of the cameras and of their stream."""

from __future__ import annotations

from sim.theatre.faults.camera_link import DEVICE_FAULTS
from sim.theatre.faults.camera_sight import SIGHT_FAULTS
from sim.theatre.faults.kinds import FaultKind, at_most_all

CAMERA_FAULTS = (
    *SIGHT_FAULTS,
    FaultKind(
        "camera_drop",
        "camera",
        "drop NUMBER %",
        "That share of the image packets is lost.",
        check=at_most_all,
    ),
    *DEVICE_FAULTS,
)
