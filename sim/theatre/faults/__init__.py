"""Faults, scripted and live: what goes wrong in the theatre, and when.

Each device has a module with its kinds of fault; a device asks its own board whether one acts now.
"""

from sim.theatre.faults.board import FaultBoard
from sim.theatre.faults.fault import Fault
from sim.theatre.faults.kinds import FaultKind
from sim.theatre.faults.language import (
    FAULT_KINDS,
    TRIGGERS,
    begin_now,
    check_faults,
    parse_faults,
    read_faults,
)

__all__ = [
    "FAULT_KINDS",
    "TRIGGERS",
    "Fault",
    "FaultBoard",
    "FaultKind",
    "begin_now",
    "check_faults",
    "parse_faults",
    "read_faults",
]
