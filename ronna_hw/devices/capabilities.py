"""Where drivers pass on their link traffic, byte for byte.

A driver that supports it offers `record_bytes`; others need none of this.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Protocol, runtime_checkable


class Direction(StrEnum):
    """As seen from this computer."""

    SENT = "sent"
    RECEIVED = "received"


class Passed(NamedTuple):
    """Bytes that passed at a time of the host's monotonic clock."""

    host_ns: int
    direction: Direction
    data: bytes


class ByteSink(Protocol):
    """Called by drivers from any thread. Never blocks, never raises. `link` is such as `robot.master.eki`."""

    def passed(self, link: str, direction: Direction, data: bytes) -> None:
        """These bytes have just passed."""
        ...

    def passed_earlier(self, link: str, all_passed: Sequence[Passed]) -> None:
        """Traffic seen by another process since it was last queried, in order."""
        ...

    def note(self, link: str, **facts: str | float) -> None:
        """Information about the link other than bytes: another rate, bytes lost, one image of a stream."""
        ...


@runtime_checkable
class RecordsBytes(Protocol):
    """A device whose driver passes on the bytes of its links."""

    def record_bytes(self, sink: ByteSink | None) -> None:
        """Pass every byte to `sink` from the next `connect` on; None stops it."""
        ...


MESSAGES = "messages"  # the name of the fact that a person fulfils by acknowledging messages


@dataclass(frozen=True)
class Fact:
    """One condition: name, such as `operating mode`, finding, whether a case can begin, else what to do."""

    name: str
    found: str
    ready: bool = True
    advice: str = ""


def counted_fact(name: str, count: int) -> tuple[Fact, ...]:
    """What a driver counted, as it tells it unsolicited; nothing while there was none."""
    return (Fact(name, str(count)),) if count else ()


@runtime_checkable
class TellsReadiness(Protocol):
    """A device that can report more about its readiness than that it answers."""

    def readiness(self, timeout_s: float = 1.0) -> Sequence[Fact]:
        """Everything that decides whether it can be activated, read now. Allowed from CONNECTED.

        Moves nothing and changes nothing. Raises the errors of reading from the device.
        """
        ...
