"""Byte sink that remembers."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence

from ronna_hw.devices.capabilities import Direction, PassedBytes


class RecordedBytes:
    """Bytes handed over by drivers, by link."""

    def __init__(self) -> None:
        self.by_link: dict[str, list[tuple[Direction, bytes]]] = defaultdict(list)
        self.notes: list[tuple[str, dict[str, str | float]]] = []

    def on_bytes(self, link: str, direction: Direction, data: bytes) -> None:
        self.by_link[link].append((direction, data))

    def on_earlier_bytes(self, link: str, all_passed: Sequence[PassedBytes]) -> None:
        self.by_link[link] += [(one.direction, one.data) for one in all_passed]

    def note(self, link: str, **facts: str | float) -> None:
        self.notes.append((link, facts))

    def sent(self, link: str) -> bytes:
        return b"".join(data for direction, data in self.by_link[link] if direction is Direction.SENT)

    def received(self, link: str) -> bytes:
        return b"".join(data for direction, data in self.by_link[link] if direction is Direction.RECEIVED)
