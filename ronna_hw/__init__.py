"""Shared interfaces and base modules for the drivers, simulators and procedures; imports none of them.

The front door is exported here and imported on first use: device processes do not need it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ronna_hw.frames import Frame
    from ronna_hw.theatre import SimulatedTheatre, Theatre, open_theatre, simulated_theatre

__all__ = ["Frame", "SimulatedTheatre", "Theatre", "open_theatre", "simulated_theatre"]

_HOMES = {
    "Frame": "ronna_hw.frames",
    "SimulatedTheatre": "ronna_hw.theatre",
    "Theatre": "ronna_hw.theatre",
    "open_theatre": "ronna_hw.theatre",
    "simulated_theatre": "ronna_hw.theatre",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
