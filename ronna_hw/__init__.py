"""Shared interfaces and base modules for the drivers, simulators and procedures; imports none of them.

The front door is exported here and imported on first use: device processes do not need it.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ronna_hw.devices.stray_tracks import StrayTrack, StrayWarning, track_strays
    from ronna_hw.frames import Frame
    from ronna_hw.loaded_run import LoadedRun, RunTable, RunWarning, load_run
    from ronna_hw.theatre import SimulatedTheatre, Theatre, open_theatre, simulated_theatre

__all__ = [
    "Frame",
    "LoadedRun",
    "RunTable",
    "RunWarning",
    "SimulatedTheatre",
    "StrayTrack",
    "StrayWarning",
    "Theatre",
    "load_run",
    "open_theatre",
    "simulated_theatre",
    "track_strays",
]

_HOMES = {
    "Frame": "ronna_hw.frames",
    "LoadedRun": "ronna_hw.loaded_run",
    "RunTable": "ronna_hw.loaded_run",
    "RunWarning": "ronna_hw.loaded_run",
    "SimulatedTheatre": "ronna_hw.theatre",
    "StrayTrack": "ronna_hw.devices.stray_tracks",
    "StrayWarning": "ronna_hw.devices.stray_tracks",
    "Theatre": "ronna_hw.theatre",
    "load_run": "ronna_hw.loaded_run",
    "open_theatre": "ronna_hw.theatre",
    "simulated_theatre": "ronna_hw.theatre",
    "track_strays": "ronna_hw.devices.stray_tracks",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    return list(__all__)
