"""Optional capabilities of a driver beyond the interface of its device.

A driver may pass on its link traffic, byte for byte, and report the conditions for beginning a case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, NamedTuple, Protocol, runtime_checkable

if TYPE_CHECKING:  # a real-time process imports this
    import numpy as np
    from numpy.typing import NDArray


class Direction(StrEnum):
    """Direction of traffic as seen from this computer."""

    SENT = "sent"
    RECEIVED = "received"


class PassedBytes(NamedTuple):
    """Bytes transferred, with their host monotonic time."""

    host_ns: int
    direction: Direction
    data: bytes


class ByteSink(Protocol):
    """Receiver of link traffic. Drivers call it from any thread.

    Never blocks, never raises. `link` is such as `robot.master.eki`.
    """

    def on_bytes(self, link: str, direction: Direction, data: bytes) -> None:
        """Receive bytes as they are transferred."""

    def on_earlier_bytes(self, link: str, all_passed: Sequence[PassedBytes]) -> None:
        """Receive, in order, the traffic that another process has recorded since the last query."""

    def note(self, link: str, **facts: str | float) -> None:
        """Receive a link event other than traffic, such as a rate change, lost bytes or a streamed image."""


@runtime_checkable
class RecordsBytes(Protocol):
    """Device whose driver can forward the bytes on its links."""

    def record_bytes(self, sink: ByteSink | None) -> None:
        """Forward every byte to `sink` from the next `connect` on; None disables forwarding."""


class StreamCycles(NamedTuple):
    """Cycles of an arm's stream, one entry each, oldest first."""

    received_ns: NDArray[np.int64]  # arrival of the telegram, host monotonic
    device_clock: NDArray[np.uint64]  # in the controller's own unit
    measured_rad: NDArray[np.float64]  # (n, axes)
    commanded_rad: NDArray[np.float64]  # (n, axes), sent in reply


@runtime_checkable
class RecordsCycles(Protocol):
    """Arm that keeps the latest cycles of its stream."""

    def cycles_since(self, after_ns: int) -> StreamCycles | None:
        """Return the kept cycles that came after a host monotonic time, or None without a stream.

        Asks nothing of the device. Never raises, in any thread.
        """


MESSAGES = "messages"  # the name of the fact that a person fulfils by acknowledging messages
# The name of the fact of a pressed emergency stop, and part of the fault of an arm that it stopped.
EMERGENCY_STOP = "emergency stop"


@dataclass(frozen=True)
class Fact:
    """Condition reported by a device, such as `operating mode`, and its finding.

    If it keeps a case from beginning, `ready` is False and `advice` says what to do.
    """

    name: str
    found: str
    ready: bool = True
    advice: str = ""


def report_count(name: str, count: int) -> tuple[Fact, ...]:
    """Report a driver's non-zero count as an unsolicited fact."""
    return (Fact(name, str(count)),) if count else ()


@runtime_checkable
class TellsReadiness(Protocol):
    """Device that reports its readiness in detail, beyond merely responding."""

    def readiness(self, timeout_s: float = 1.0) -> Sequence[Fact]:
        """Read all conditions for activating the device. Allowed from CONNECTED.

        Moves nothing and changes nothing. Raises the errors of reading from the device.
        """
