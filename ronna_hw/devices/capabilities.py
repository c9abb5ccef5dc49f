"""Capabilities that a driver may offer beyond the interface of its device.

A driver may pass on its link traffic, byte for byte, and report the conditions for beginning a case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple, Protocol, runtime_checkable


class Direction(StrEnum):
    """Direction of traffic, as seen from this computer."""

    SENT = "sent"
    RECEIVED = "received"


class PassedBytes(NamedTuple):
    """Bytes that passed at a time of the monotonic clock of the host."""

    host_ns: int
    direction: Direction
    data: bytes


class ByteSink(Protocol):
    """Receiver of link traffic, called by drivers from any thread.

    Never blocks, never raises. `link` is such as `robot.master.eki`.
    """

    def on_bytes(self, link: str, direction: Direction, data: bytes) -> None:
        """Take bytes that have just passed."""
        ...

    def on_earlier_bytes(self, link: str, all_passed: Sequence[PassedBytes]) -> None:
        """Take traffic, in order, that another process saw since it was last queried."""
        ...

    def note(self, link: str, **facts: str | float) -> None:
        """Take facts about the link other than bytes: a new rate, bytes lost, one image of a stream."""
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
    """A condition that a device reports: name, such as `operating mode`, and finding.

    If it keeps a case from beginning, `ready` is False and `advice` says what to do.
    """

    name: str
    found: str
    ready: bool = True
    advice: str = ""


def report_count(name: str, count: int) -> tuple[Fact, ...]:
    """Report a driver's count as an unsolicited fact; none while the count is 0."""
    return (Fact(name, str(count)),) if count else ()


@runtime_checkable
class TellsReadiness(Protocol):
    """A device that reports more about its readiness than that it answers."""

    def readiness(self, timeout_s: float = 1.0) -> Sequence[Fact]:
        """Read everything that decides whether the device can be activated. Allowed from CONNECTED.

        Moves nothing and changes nothing. Raises the errors of reading from the device.
        """
        ...
