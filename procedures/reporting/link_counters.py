"""Statistics of the drivers' links whenever they end, from the log."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

ACTIVE = "active"  # the state that a device left
FRAME = ("timestamp", "level", "event", "device", "before")


def link_counters(log: Sequence[Mapping[str, Any]]) -> tuple[tuple[str, str], ...]:
    """Device, and its counters in words, for every time that it was active."""
    ended = [line for line in log if line.get("before") == ACTIVE and "device" in line]
    counted = [
        (str(line["device"]), ", ".join(f"{name} {count}" for name, count in _counters(line, "")))
        for line in ended
    ]
    return tuple((device, counters) for device, counters in counted if counters)


def _counters(value: Mapping[str, Any], where: str) -> Iterator[tuple[str, int | float]]:
    for key, one in value.items():
        name = f"{where} {key}".strip().replace("_", " ")
        if key in FRAME or isinstance(one, bool):
            continue
        if isinstance(one, int | float):
            yield name, one
        elif isinstance(one, Mapping):
            yield from _counters(one, "" if not where and key in ("frames", "link") else name)
        elif isinstance(one, list):
            for number, item in enumerate(one, 1):
                if isinstance(item, Mapping):
                    yield from _counters(item, f"{name} {number}")
