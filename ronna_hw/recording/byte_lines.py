"""One line of JSON for each piece of link traffic, written and read back.

    {"host_time":"2026-11-20T23:58:31.000123+00:00","theatre_time_s":1.250000,"direction":"sent","hex":"4150"}

Instead of direction and bytes a line may have a `note`. A torn last line, left by a crash, is skipped.
"""

from __future__ import annotations

import io
import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

from ronna_hw.bounded_input import InputRefused, parse_json
from ronna_hw.devices.byte_sink import Direction
from ronna_hw.host.regular_file import open_regular

BYTES_FOLDER = "bytes"
FILE_NAMES = ("{link}.a.jsonl", "{link}.b.jsonl")  # written alternately
LARGEST_FILE_BYTES = 64_000_000  # twice what the flight recorder writes into one
_BEGINNING = '{"host_time"'
_HEX = {direction: f',"direction":"{direction}","hex":"' for direction in Direction}
Facts = Mapping[str, str | float]


@dataclass(frozen=True)
class LinkLine:
    """Bytes, or a note, of one link."""

    link: str
    host_time: datetime
    theatre_time_s: float
    direction: Direction | None = None
    data: bytes = b""
    note: Facts = field(default_factory=dict)


def encode_bytes(epoch_ns: int, theatre_time_s: float, direction: Direction, data: bytes) -> str:
    """The line for bytes that passed at `epoch_ns`."""
    return f'{_moment(epoch_ns, theatre_time_s)}{_HEX[direction]}{data.hex()}"}}\n'


def encode_note(epoch_ns: int, theatre_time_s: float, facts: Facts) -> str:
    """The line for a note."""
    return f'{_moment(epoch_ns, theatre_time_s)},"note":{json.dumps(dict(facts))}}}\n'


def links_of(folder: Path) -> tuple[str, ...]:
    """Names of the links with bytes in a folder."""
    names = {path.name.rsplit(".", 2)[0] for path in folder.glob("*.jsonl")}
    return tuple(sorted(names))


def read_link(folder: Path, link: str) -> Iterator[LinkLine]:
    """Everything stored of a link, oldest first. Raises INP-001 for a file that is too large, OSError."""
    files = [folder / name.format(link=link) for name in FILE_NAMES]
    parts = [_read(link, path) for path in files if path.exists()]
    begun = [(first, part) for part in parts if (first := next(part, None)) is not None]
    for first, part in sorted(begun, key=lambda one: one[0].host_time):
        yield first
        yield from part


def _read(link: str, path: Path) -> Iterator[LinkLine]:
    with io.TextIOWrapper(open_regular(path), encoding="ascii", errors="replace") as file:
        if os.fstat(file.fileno()).st_size > LARGEST_FILE_BYTES:
            raise InputRefused(f"{path.name} is too large", limit=f"{LARGEST_FILE_BYTES} bytes")
        for text in file:
            if not text.startswith(_BEGINNING):
                continue  # torn
            try:
                content = parse_json(text)
                host_time = datetime.fromisoformat(content["host_time"])
                if host_time.tzinfo is None:
                    continue  # not ours
                yield LinkLine(
                    link,
                    host_time.astimezone(UTC),
                    float(content["theatre_time_s"]),
                    Direction(content["direction"]) if "direction" in content else None,
                    bytes.fromhex(content.get("hex", "")),
                    dict(content.get("note", {})),
                )
            except (ValueError, KeyError, TypeError, AttributeError, OverflowError):
                continue  # torn


def _moment(epoch_ns: int, theatre_time_s: float) -> str:
    second, ns = divmod(epoch_ns, 1_000_000_000)
    moment = f"{_to_the_second(second)}.{ns // 1000:06d}+00:00"
    return f'{{"host_time":"{moment}","theatre_time_s":{theatre_time_s:.6f}'


@lru_cache(maxsize=4)  # thousands of telegrams pass within a second
def _to_the_second(second: int) -> str:
    return datetime.fromtimestamp(second, UTC).strftime("%Y-%m-%dT%H:%M:%S")
