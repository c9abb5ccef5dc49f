"""Table of a stream's last cycles, attached to the error that ended it."""

from __future__ import annotations

from collections.abc import Sequence
from math import degrees

from ronna_hw.arm.kinematics import JointRanges
from ronna_hw.arm_stream.records import RecordedCycle
from ronna_hw.errors import RonnaError
from ronna_hw.vectors import JointVector

FILE_NAME = "flight-record-{arm}.txt"


def attach_flight_record(
    error: RonnaError, name: str, arm: JointRanges, clock_name: str, cycles: Sequence[RecordedCycle]
) -> None:
    """Attach the last cycles to an error, as a file for the run folder."""
    if cycles:
        title = f"{name}: the last {len(cycles)} cycles before {error}"
        error.attachments[FILE_NAME.format(arm=name)] = flight_table(cycles, title, arm, clock_name)


def flight_table(cycles: Sequence[RecordedCycle], title: str, arm: JointRanges, clock_name: str) -> str:
    """Format cycles as a table, oldest first; times in ms before the last cycle, angles in deg."""
    columns = (
        *("cycle", clock_name, "ms", "turnaround us", "choice"),
        *(f"{axis} measured" for axis in arm.axis_names),
        *(f"{axis} sent" for axis in arm.axis_names),
        *(f"{axis} behind" for axis in arm.axis_names),
    )
    rows = [_format_row(cycle, cycles[-1].received_ns) for cycle in cycles]
    widths = [max(len(text) for text in column) for column in zip(columns, *rows, strict=True)]
    lines = [title, ""]
    for row in (columns, *rows):
        lines.append("  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)))
    return "\n".join(lines) + "\n"


def _format_row(cycle: RecordedCycle, last_ns: int) -> tuple[str, ...]:
    behind = [s - m for s, m in zip(cycle.sent_rad, cycle.measured_rad, strict=True)]
    return (
        str(cycle.cycle),
        str(cycle.device_clock),
        f"{(cycle.received_ns - last_ns) / 1e6:.2f}",
        f"{cycle.turnaround_us:.1f}",
        cycle.choice.name.lower(),
        *_format_degrees(cycle.measured_rad),
        *_format_degrees(cycle.sent_rad),
        *(f"{degrees(angle):.4f}" for angle in behind),
    )


def _format_degrees(joints_rad: JointVector) -> tuple[str, ...]:
    return tuple(f"{degrees(angle):.4f}" for angle in joints_rad)
