"""Faults, scripted and live: what goes wrong in the theatre, and when.

Each device has a module with its kinds of fault; a device queries its own board for active ones.
"""

from sim.world.faults.board import FaultBoard
from sim.world.faults.fault import Fault
from sim.world.faults.kinds import FaultKind
from sim.world.faults.language import (
    DEVICES,
    FAULT_KINDS,
    begin_now,
    begin_with_step,
    check_faults,
    parse_faults,
    parse_request,
    read_faults,
    without_fault,
)

__all__ = [
    "DEVICES",
    "FAULT_KINDS",
    "Fault",
    "FaultBoard",
    "FaultKind",
    "begin_now",
    "begin_with_step",
    "check_faults",
    "parse_faults",
    "parse_request",
    "read_faults",
    "without_fault",
]
