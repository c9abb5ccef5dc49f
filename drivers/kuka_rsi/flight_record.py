"""The last cycles before a fault, as a readable table."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees

from drivers.kuka_rsi.errors import RecordedCycle
from drivers.kuka_rsi.realtime.settings import AXIS_NAMES
from ronna_hw.devices.readings import JointVector
from ronna_hw.errors import RonnaError

FILE_NAME = "flight-record-{arm}.txt"
_HEAD = ("cycle", "IPOC", "ms", "turnaround us", "choice")


def attach_flight_record(error: RonnaError, arm: str, cycles: Sequence[RecordedCycle]) -> None:
    """Attach the cycles before it to an error, as a file for the run folder."""
    if cycles:
        title = f"{arm}: the last {len(cycles)} cycles before {error}"
        error.attachments[FILE_NAME.format(arm=arm)] = flight_table(cycles, title)


def flight_table(cycles: Sequence[RecordedCycle], title: str) -> str:
    """Aligned columns, oldest cycle first; ms before the last one, angles in deg."""
    columns = (
        *_HEAD,
        *(f"{axis} measured" for axis in AXIS_NAMES),
        *(f"{axis} sent" for axis in AXIS_NAMES),
        *(f"{axis} behind" for axis in AXIS_NAMES),
    )
    rows = [_row(cycle, cycles[-1].received_ns) for cycle in cycles]
    widths = [max(len(text) for text in column) for column in zip(columns, *rows, strict=True)]
    lines = [title, ""]
    for row in (columns, *rows):
        lines.append("  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)))
    return "\n".join(lines) + "\n"


def _row(cycle: RecordedCycle, last_ns: int) -> tuple[str, ...]:
    behind = [s - m for s, m in zip(cycle.sent_rad, cycle.measured_rad, strict=True)]
    return (
        str(cycle.cycle),
        str(cycle.IPOC),
        f"{(cycle.received_ns - last_ns) / 1e6:.2f}",
        f"{cycle.turnaround_us:.1f}",
        cycle.choice,
        *_degrees(cycle.measured_rad),
        *_degrees(cycle.sent_rad),
        *(f"{degrees(angle):.4f}" for angle in behind),
    )


def _degrees(joints_rad: JointVector) -> tuple[str, ...]:
    return tuple(f"{degrees(angle):.4f}" for angle in joints_rad)
