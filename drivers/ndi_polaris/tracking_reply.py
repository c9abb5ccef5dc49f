"""What one TX or BX reply says, before it is judged. Both decoders give this."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from ronna_hw.devices.readings import Quaternion, Vector3
from ronna_hw.wire.polaris import PortStatus, SystemStatus

NO_STATUS = PortStatus(0)


class HandleState(Enum):
    """How the unit reports a handle."""

    VALID = "valid"
    MISSING = "missing"
    DISABLED = "disabled"
    UNOCCUPIED = "unoccupied"


@dataclass(frozen=True)
class HandleReport:
    """One handle of a reply. Pose and error only when VALID; status and frame also when MISSING."""

    handle: int
    state: HandleState
    rotation: Quaternion | None = None  # tracker <- tool, scalar first, as sent: not yet normalised
    position_mm: Vector3 | None = None
    fit_error_mm: float | None = None
    port_status: PortStatus = NO_STATUS
    frame: int | None = None


@dataclass(frozen=True)
class TrackingReply:
    """A whole reply to TX or BX with the options 0001, 0800 and 1000."""

    handles: tuple[HandleReport, ...]
    strays_mm: tuple[Vector3, ...]
    stray_outside: tuple[bool, ...] | None  # as the unit says; None when it left the outside ones out
    system_status: SystemStatus
