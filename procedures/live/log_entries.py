"""Entries of a run's log beside live records: cycles in batches, lines for people, journal lines."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from procedures.live.records import LiveRecord


class JointCycles(NamedTuple):
    """Consecutive cycles of an arm, one row each."""

    arm: str
    axes: tuple[str, ...]
    times_s: NDArray[np.float64]  # theatre time
    measured_rad: NDArray[np.float64]
    commanded_rad: NDArray[np.float64] | None


class Level(IntEnum):
    """Weight of a line, as `rcl_interfaces/msg/Log` has it."""

    INFO = 20
    WARNING = 30
    ERROR = 40


class SaidLine(NamedTuple):
    """Line for people: a step, a finding, a fault."""

    theatre_time_s: float
    level: Level
    text: str


class JournalEntry(NamedTuple):
    """Line of the journal, without what only the run folder may hold."""

    theatre_time_s: float
    fields: Mapping[str, object]


class ArmDrawing(NamedTuple):
    """Arm of the robot frame as URDF, for a viewer that draws it from its joints."""

    theatre_time_s: float
    urdf: str


LogEntry = LiveRecord | JointCycles | SaidLine | JournalEntry | ArmDrawing


def time_of(entry: LogEntry) -> float:
    """Return the theatre time of an entry, of cycles that of the first."""
    return float(entry.times_s[0]) if isinstance(entry, JointCycles) else entry.theatre_time_s
