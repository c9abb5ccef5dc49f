"""Flight recorder for the traffic of all links, with its own writer thread, and a matching reader.

A caller only pays for one append to a queue. If the disk does not keep up, bytes are dropped and counted, and
a note in the link's file says how many; nobody ever waits. Each link has two files, written alternately: disk
use is bounded, and the latest part is always there. Each piece of traffic is a line of JSON::

    {"host_time":"2026-11-20T23:58:31.000123+00:00","theatre_time_s":1.250000,"direction":"sent","hex":"4150"}

Instead of direction and bytes a line may have a `note`. What is written at once is one gzip member, so `zcat`
shows a whole file. A torn member, left by a crash or a full disk, is read as far as it goes.
"""

from __future__ import annotations

import contextlib
import errno
import gzip
import json
import os
import threading
import time
import zlib
from collections import defaultdict, deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from ronna_hw.bounded_input import InputRefused, parse_json
from ronna_hw.devices.capabilities import Direction, PassedBytes
from ronna_hw.host.files import open_regular
from ronna_hw.logs import logger

BYTES_FOLDER = "bytes"
FILE_NAMES = ("{link}.a.jsonl.gz", "{link}.b.jsonl.gz")  # written alternately
# Each of a link's two files: one contains at least the last five minutes of a robot link's 4 ms telegrams.
FILE_BYTES = 8_000_000
LARGEST_FILE_BYTES = 16_000_000  # twice what the flight recorder writes into one
LARGEST_CONTENT_BYTES = 500_000_000  # telegrams shrink to a tenth, and may be more alike than they are
MEMBER_START = b"\x1f\x8b\x08\0\0\0\0\0"  # gzip, deflated, without name and time
QUEUE_LENGTH = 20_000  # entries that wait for the disk: seconds of traffic on all links
WRITE_PERIOD_S = 0.05  # host time; lost if the process is killed
CLOSE_LIMIT_S = 2.0  # for what is still queued
_BEGINNING = '{"host_time"'
_HEX = {direction: f',"direction":"{direction}","hex":"' for direction in Direction}
Facts = Mapping[str, str | float]


class _Entry(NamedTuple):
    """Traffic of a link, in order, or facts about it, with the times at which it was handed over."""

    link: str
    host_ns: int
    theatre_time_s: float
    passed: Sequence[PassedBytes] = ()
    facts: Facts | None = None
    earliest_s: float = 0.0  # theatre time
    rate: float = 0.0  # theatre time per nanosecond of host time

    @property
    def lines(self) -> int:
        return len(self.passed) if self.facts is None else 1


class FlightRecorder:
    """`ByteSink` that stores the traffic of a run in a folder."""

    def __init__(
        self,
        folder: Path,
        now_s: Callable[[], float],
        *,
        file_bytes: int = FILE_BYTES,
        queue_length: int = QUEUE_LENGTH,
    ) -> None:
        """Start recording; `now_s` returns theatre time. Raises OSError if the folder cannot be created."""
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder
        self._now_s = now_s
        self._file_bytes = file_bytes
        self._epoch_ns = time.time_ns() - time.monotonic_ns()
        self._queue: deque[_Entry] = deque()
        self._queue_length = queue_length
        self._waiting = 0  # lines in the queue
        self._dropped: dict[str, int] = defaultdict(int)
        self._lock = threading.Lock()  # protects the counts of waiting and dropped lines
        # By link: host and theatre time of the last query.
        self._last_queries: dict[str, tuple[int, float]] = {}
        self._last_s = 0.0
        self._files: dict[str, AlternatingFiles | None] = {}  # None: not writable
        self._ending = threading.Event()
        self._writer = threading.Thread(target=self._run, name="flight recorder", daemon=True)
        self._writer.start()

    def on_bytes(self, link: str, direction: Direction, data: bytes) -> None:
        """Record bytes as they are transferred."""
        now_ns = time.monotonic_ns()
        self._put(_Entry(link, now_ns, self._theatre_s(), (PassedBytes(now_ns, direction, data),)))

    def on_earlier_bytes(self, link: str, all_passed: Sequence[PassedBytes]) -> None:
        """Record earlier traffic, interpolating theatre time since the last call for this link."""
        now_ns, now_s = time.monotonic_ns(), self._theatre_s()
        before_ns, before_s = self._last_queries.get(link, (now_ns, now_s))
        self._last_queries[link] = now_ns, now_s
        rate = (now_s - before_s) / (now_ns - before_ns) if now_ns > before_ns else 0.0
        self._put(_Entry(link, now_ns, now_s, all_passed, None, before_s, rate))

    def note(self, link: str, **facts: str | float) -> None:
        """Record facts about a link."""
        self._put(_Entry(link, time.monotonic_ns(), self._theatre_s(), facts=facts))

    def close(self) -> None:
        """Write queued entries and close the files. Bounded in time; never raises."""
        self._ending.set()
        if self._writer is not threading.current_thread():
            self._writer.join(CLOSE_LIMIT_S)

    def _put(self, entry: _Entry) -> None:
        with self._lock:
            if self._waiting < self._queue_length and not self._ending.is_set():
                self._waiting += entry.lines
                self._queue.append(entry)
            else:
                self._dropped[entry.link] += entry.lines

    def _theatre_s(self) -> float:
        with contextlib.suppress(ValueError):  # the clock may end before the last link does
            self._last_s = self._now_s()
        return self._last_s

    def _run(self) -> None:
        while not self._ending.wait(WRITE_PERIOD_S):
            self._write_waiting()
        self._write_waiting()
        for files in self._files.values():
            if files is not None:
                files.close()

    def _write_waiting(self) -> None:
        lines: dict[str, list[str]] = defaultdict(list)
        for _ in range(len(self._queue)):
            entry = self._queue.popleft()
            lines[entry.link] += self._encode(entry)
        with self._lock:
            self._waiting -= sum(map(len, lines.values()))
            dropped, self._dropped = self._dropped, defaultdict(int)
        lost = {link: dropped.get(link, 0) + len(lines[link]) for link in {*lines, *dropped}}
        for link, count in dropped.items():
            note = _Entry(link, time.monotonic_ns(), self._last_s, facts={"dropped": count})
            lines[link] += self._encode(note)
        for link, new in lines.items():
            if not self._write(link, "".join(new).encode("ascii")):
                with self._lock:
                    self._dropped[link] += lost[link]

    def _encode(self, entry: _Entry) -> list[str]:
        _, now_ns, now_s, passed, facts, earliest_s, rate = entry
        if facts is not None:
            return [encode_note(self._epoch_ns + now_ns, now_s, facts)]
        return [
            encode_bytes(
                self._epoch_ns + host_ns,
                min(now_s, max(earliest_s, now_s - rate * (now_ns - host_ns))),
                direction,
                data,
            )
            for host_ns, direction, data in passed
        ]

    def _write(self, link: str, lines: bytes) -> bool:
        """Write lines; returns whether it succeeded. A failed link is retried each time."""
        files = self._files.get(link)
        try:
            if files is None:
                files = AlternatingFiles(self._folder, link, self._file_bytes)
            files.write(lines)
        except OSError as error:
            if files is not None:
                with contextlib.suppress(OSError):
                    files.close()
            if link not in self._files or files is not None:  # said once
                logger(part="flight recorder").warning("bytes are not recorded", link=link, cause=error)
            self._files[link] = None
            return False
        self._files[link] = files
        return True


class AlternatingFiles:
    """Two alternating files of a link: when one is full, the other is emptied and written."""

    def __init__(self, folder: Path, link: str, limit_bytes: int) -> None:
        """Continue the files left by an earlier process of the same run. Raises OSError."""
        self._paths = [folder / name.format(link=link) for name in FILE_NAMES]
        self._limit_bytes = limit_bytes
        newest = max(self._paths, key=lambda path: path.stat().st_mtime_ns if path.exists() else 0)
        self._which = self._paths.index(newest)
        self._file = self._open(os.O_APPEND)
        self._size = os.fstat(self._file).st_size

    def write(self, lines: bytes) -> None:
        """Append complete lines. Raises OSError."""
        packed = gzip.compress(lines, compresslevel=1, mtime=0)
        if self._size and self._size + len(packed) > self._limit_bytes:
            os.close(self._file)
            self._which = 1 - self._which
            self._file = self._open(os.O_TRUNC)
            self._size = 0
        written = os.write(self._file, packed)
        self._size += written
        if written != len(packed):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def close(self) -> None:
        """Close the current file."""
        os.close(self._file)

    def _open(self, open_flags: int) -> int:
        return os.open(self._paths[self._which], os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC | open_flags, 0o666)


def encode_bytes(epoch_ns: int, theatre_time_s: float, direction: Direction, data: bytes) -> str:
    """Encode a line for bytes transferred at `epoch_ns`."""
    return f'{_format_moment(epoch_ns, theatre_time_s)}{_HEX[direction]}{data.hex()}"}}\n'


def encode_note(epoch_ns: int, theatre_time_s: float, facts: Facts) -> str:
    """Encode a line for a note."""
    return f'{_format_moment(epoch_ns, theatre_time_s)},"note":{json.dumps(dict(facts))}}}\n'


def _format_moment(epoch_ns: int, theatre_time_s: float) -> str:
    second, ns = divmod(epoch_ns, 1_000_000_000)
    moment = f"{_format_second(second)}.{ns // 1000:06d}+00:00"
    return f'{{"host_time":"{moment}","theatre_time_s":{theatre_time_s:.6f}'


@lru_cache(maxsize=4)  # thousands of telegrams pass within a second
def _format_second(second: int) -> str:
    return datetime.fromtimestamp(second, UTC).strftime("%Y-%m-%dT%H:%M:%S")


@dataclass(frozen=True)
class LinkLine:
    """Recorded bytes or note from a link."""

    link: str
    host_time: datetime
    theatre_time_s: float
    direction: Direction | None = None
    data: bytes = b""
    note: Facts = field(default_factory=dict)


def list_links(folder: Path) -> tuple[str, ...]:
    """List the links with recorded bytes in a folder."""
    return tuple(sorted({path.name.rsplit(".", 3)[0] for path in folder.glob("*.jsonl.gz")}))


def read_link(folder: Path, link: str) -> Iterator[LinkLine]:
    """Read all recorded traffic of a link, oldest first.

    Raises INP-001 for a file that is too large, packed or unpacked, and OSError.
    """
    files = [folder / name.format(link=link) for name in FILE_NAMES]
    parts = [_read_file(link, path) for path in files if path.exists()]
    started_parts = [(first, part) for part in parts if (first := next(part, None)) is not None]
    for first, part in sorted(started_parts, key=lambda pair: pair[0].host_time):
        yield first
        yield from part


def _read_file(link: str, path: Path) -> Iterator[LinkLine]:
    for text in _unpack_lines(path):
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


def _unpack_lines(path: Path) -> Iterator[str]:
    with open_regular(path) as file:
        if os.fstat(file.fileno()).st_size > LARGEST_FILE_BYTES:
            raise InputRefused(f"{path.name} is too large", limit=f"{LARGEST_FILE_BYTES} bytes")
        packed = file.read(LARGEST_FILE_BYTES)
    remaining_bytes = LARGEST_CONTENT_BYTES
    for member in packed.split(MEMBER_START)[1:]:
        unpacker = zlib.decompressobj(zlib.MAX_WBITS | 16)  # 16: gzip
        pieces = []
        with contextlib.suppress(zlib.error):
            pieces.append(unpacker.decompress(MEMBER_START + member, remaining_bytes + 1))
        content = b"".join(pieces)
        remaining_bytes -= len(content)
        if remaining_bytes < 0:
            raise InputRefused(f"{path.name} expands too far", limit=f"{LARGEST_CONTENT_BYTES} bytes")
        yield from content.decode("ascii", errors="replace").splitlines()
