"""`ronna-procedure bytes`: a window of what the flight recorder kept, for people, scripts and text2pcap."""

from __future__ import annotations

import heapq
import json
import math
import sys
from collections.abc import Iterator
from pathlib import Path

from ronna_hw.command_line.errors import PathProblem, UsageMistake
from ronna_hw.command_line.terminal import tell
from ronna_hw.devices.capabilities import Direction
from ronna_hw.evidence.inspection import inspected
from ronna_hw.recording.flight_recorder import BYTES_FOLDER, LinkLine, links_of, read_link
from ronna_hw.text import printable

ROW_BYTES = 16
MARKS = {Direction.SENT: "O", Direction.RECEIVED: "I"}  # outbound and inbound, as text2pcap has them


def print_bytes(
    run_folder: Path, link: str | None, from_s: float | None, to_s: float | None, *, as_json: bool
) -> None:
    """Print the window by time, and before it what is not as the run left it.

    Raises CLI-005 without bytes, CLI-001 for a wrong link or window.
    """
    folder = run_folder / BYTES_FOLDER
    links = links_of(folder)
    if not links:
        raise PathProblem(f"{folder} has no recorded link bytes", expected="the folder of a run")
    wanted = [name for name in links if link is None or name == link or name.startswith(f"{link}.")]
    if not wanted:
        raise UsageMistake(f"the run has no link {link}", expected=f"one of {', '.join(links)}")
    begin_s, end_s = from_s if from_s is not None else -math.inf, to_s if to_s is not None else math.inf
    if begin_s > end_s:
        raise UsageMistake("the window ends before it begins", got=f"--from {begin_s:g} --to {end_s:g}")
    for change in inspected(run_folder).changes:
        tell(f"NOT AS THE RUN LEFT IT: {change}")
    merged = heapq.merge(*(read_link(folder, name) for name in wanted), key=lambda line: line.host_time)
    first_s, last_s, printed = math.inf, -math.inf, False
    for line in merged:
        first_s, last_s = min(first_s, line.theatre_time_s), max(last_s, line.theatre_time_s)
        if begin_s <= line.theatre_time_s <= end_s:
            printed = True
            sys.stdout.write(_as_json(line) if as_json else _as_dump(line))
    if not printed:
        kept = f"{first_s:.1f} to {last_s:.1f} s" if first_s <= last_s else "nothing"
        tell(f"no bytes in this window; {', '.join(wanted)} recorded {kept}")


def _as_json(line: LinkLine) -> str:
    content: dict[str, object] = {
        "link": line.link,
        "host_time": line.host_time.isoformat(timespec="microseconds"),
        "theatre_time_s": line.theatre_time_s,
    }
    if line.direction is None:
        content["note"] = line.note
    else:
        text = "".join(_printable(line.data))
        content |= {"direction": line.direction, "hex": line.data.hex(), "text": text}
    return json.dumps(content) + "\n"


def _as_dump(line: LinkLine) -> str:
    """Lines with # are comments, I and O the directions; the text behind the bytes is for people."""
    head = f"# {printable(line.link)}, theatre {line.theatre_time_s:.6f} s"
    if line.direction is None:
        return f"{head}: {printable(', '.join(f'{name} {value}' for name, value in line.note.items()))}\n"
    rows = "".join(_rows(line.data))
    moment = f"{line.host_time:%Y-%m-%dT%H:%M:%S.%fZ}"
    size = f"{line.direction}, {len(line.data)} bytes"
    return f"{head}, {size}\n{MARKS[line.direction]} {moment}\n{rows}\n"


def _rows(data: bytes) -> Iterator[str]:
    for at in range(0, len(data), ROW_BYTES):
        row = data[at : at + ROW_BYTES]
        yield f"{at:06x} {row.hex(' '):<{3 * ROW_BYTES}}  {''.join(_printable(row))}\n"


def _printable(data: bytes) -> Iterator[str]:
    return (chr(byte) if 0x20 <= byte < 0x7F else "." for byte in data)
