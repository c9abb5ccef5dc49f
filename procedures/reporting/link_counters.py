"""Statistics of the drivers' links over a run, from the log of every time that they ended."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from ronna_hw.text import counted

ACTIVE = "active"  # the state that a device left
CONNECTED = "connected"  # the event with which counters of the connection begin
LINK = "link"  # what a connection counts, from its beginning
FRAME = ("timestamp", "level", "event", "device", "before")


def link_counters(log: Sequence[Mapping[str, Any]]) -> tuple[tuple[str, str, str], ...]:
    """Device, how often it was active, and its counters of all that time in words."""
    totals: dict[str, _Totals] = {}
    for line in log:
        if "device" not in line:
            continue
        of_device = totals.setdefault(str(line["device"]), _Totals())
        if line.get("event") == CONNECTED:
            of_device.connection.clear()
        elif line.get("before") == ACTIVE:
            of_device.add(line)
    return tuple(
        (device, counted(one.times, "time"), ", ".join(f"{name} {count}" for name, count in one.sums.items()))
        for device, one in totals.items()
        if one.sums
    )


@dataclass
class _Totals:
    """Sums over the times that a device was active; counters of its connection go on from one to the next."""

    times: int = 0
    sums: dict[str, int | float] = field(default_factory=dict)
    connection: dict[str, int | float] = field(default_factory=dict)  # its counters at the end before

    def add(self, line: Mapping[str, Any]) -> None:
        """One more time."""
        link = line.get(LINK)
        going_on = dict(_counters(link, "")) if isinstance(link, Mapping) else {}
        counts = list(_counters(line, ""))
        self.times += bool(counts)
        for name, count in counts:
            since = self.connection.get(name, 0) if going_on.get(name) == count else 0
            self.sums[name] = self.sums.get(name, 0) + count - since
        self.connection |= going_on


def _counters(value: Mapping[str, Any], where: str) -> Iterator[tuple[str, int | float]]:
    for key, one in value.items():
        name = f"{where} {key}".strip().replace("_", " ")
        if key in FRAME or isinstance(one, bool):
            continue
        if isinstance(one, int | float):
            yield name, one
        elif isinstance(one, Mapping):
            yield from _counters(one, "" if not where and key in ("frames", LINK) else name)
        elif isinstance(one, list):
            for number, item in enumerate(one, 1):
                if isinstance(item, Mapping):
                    yield from _counters(item, f"{name} {number}")
