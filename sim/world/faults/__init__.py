"""Theatre faults, scripted or injected live.

Each device has a module with its kinds of fault, and queries its own board for the active ones.
"""

from sim.world.faults.board import FaultBoard, begin_now, begin_with_step, without_fault
from sim.world.faults.fault import Fault, FaultKind
from sim.world.faults.language import (
    DEVICES,
    FAULT_KINDS,
    check_faults,
    devices_of,
    parse_faults,
    parse_request,
    read_faults,
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
    "devices_of",
    "parse_faults",
    "parse_request",
    "read_faults",
    "without_fault",
]
