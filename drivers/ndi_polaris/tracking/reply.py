"""Content of a TX or BX reply as sent, the common result of both decoders."""

from __future__ import annotations

from enum import Enum
from typing import NamedTuple

from ronna_hw.devices.readings import Quaternion, Vector3


class HandleState(Enum):
    """How the unit reports a handle."""

    VALID = "valid"
    MISSING = "missing"
    DISABLED = "disabled"
    UNOCCUPIED = "unoccupied"


class HandleReport(NamedTuple):
    """One handle of a reply. Pose and error only when VALID; status and frame also when MISSING."""

    handle: int
    state: HandleState
    rotation: Quaternion | None = None  # tracker <- tool, scalar first, as sent: not yet normalised
    position_mm: Vector3 | None = None
    fit_error_mm: float | None = None
    port_status: int = 0  # bits of PortStatus
    frame: int | None = None


class TrackingReply(NamedTuple):
    """A complete reply to TX or BX with the options 0001, 0800 and 1000."""

    handles: tuple[HandleReport, ...]
    strays_mm: tuple[Vector3, ...]
    stray_outside: tuple[bool, ...] | None  # the unit's bits; None when it omitted those outside
    system_status: int  # bits of SystemStatus
