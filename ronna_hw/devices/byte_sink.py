"""Where drivers hand over what passes on their links, byte for byte.

A driver that can do so offers `record_bytes`; one that cannot needs nothing of this.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import NamedTuple, Protocol, runtime_checkable


class Direction(StrEnum):
    """Seen from this computer."""

    SENT = "sent"
    RECEIVED = "received"


class Passed(NamedTuple):
    """Bytes that passed at a moment of the host's monotonic clock."""

    host_ns: int
    direction: Direction
    data: bytes


class ByteSink(Protocol):
    """Called by drivers from any thread. Never blocks, never raises. `link` is such as `robot.master.eki`."""

    def passed(self, link: str, direction: Direction, data: bytes) -> None:
        """These bytes passed just now."""
        ...

    def passed_earlier(self, link: str, all_passed: Sequence[Passed]) -> None:
        """What another process has seen since it was last asked, in order."""
        ...

    def note(self, link: str, **facts: str | float) -> None:
        """Something about the link that is no bytes: another rate, bytes lost, one image of a stream."""
        ...


@runtime_checkable
class RecordsBytes(Protocol):
    """A device whose driver hands over the bytes of its links."""

    def record_bytes(self, sink: ByteSink | None) -> None:
        """Pass every byte to `sink` from the next `connect` on; None stops it."""
        ...
