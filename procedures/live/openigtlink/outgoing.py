"""Message on its way to any number of clients, encoded once for each version of the header."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

from ronna_hw.wire.openigtlink import encode_message


class Sendable(Protocol):
    """Message that a connection can send."""

    @property
    def key(self) -> tuple[str, str]:
        """Type and name, by which a newer one replaces it."""

    @property
    def needs_metadata(self) -> bool:
        """Whether only clients with metadata may have it."""

    def encoded(self, version: int) -> bytes:
        """Return the message with a header of this version."""


@dataclass(frozen=True)
class Outgoing:
    """Message to clients. A newer one of the same type and name replaces it."""

    kind: str
    name: str
    content: bytes
    stamp_ns: int = 0
    metadata: Mapping[str, str] = field(default_factory=dict)
    needs_metadata: bool = False  # a pose that is not valid: without metadata it would look alive

    @property
    def key(self) -> tuple[str, str]:
        return self.kind, self.name

    def encoded(self, version: int) -> bytes:
        """Return the message with a header of this version."""
        return self._first if version == 1 else self._second

    @cached_property
    def _first(self) -> bytes:
        return encode_message(self.kind, self.name, self.content, self.stamp_ns)

    @cached_property
    def _second(self) -> bytes:
        metadata = (
            {**self.metadata, "Timestamp": _in_seconds(self.stamp_ns)} if self.stamp_ns else self.metadata
        )
        return encode_message(self.kind, self.name, self.content, self.stamp_ns, version=2, metadata=metadata)


def _in_seconds(stamp_ns: int) -> str:
    """Return the stamp in seconds since 1970 as text: Slicer shows no stamp of a header."""
    return f"{stamp_ns // 1_000_000_000}.{stamp_ns % 1_000_000_000:09d}"
