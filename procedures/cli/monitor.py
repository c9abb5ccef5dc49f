"""`ronna-procedure monitor`: live values of one device of a theatre file."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.devices import RobotArm
from ronna_hw.devices.reading_stream import StreamsReadings
from ronna_hw.devices.readings import ArmReading, CameraImage, StampedReading, StereoReading, TrackerFrame
from ronna_hw.near_names import did_you_mean

if TYPE_CHECKING:
    from rich.table import Table

    from ronna_hw.theatre import Theatre

SHOWN_PER_S = 10  # pictures of the table on a terminal
DECIMALS = 3
Rows = list[dict[str, object]]


def monitor(
    device: Annotated[str, Argument(help="Table of the theatre file: tracker, robot.master or stereo.")],
    config: Annotated[Path, Option(metavar="FILE", help="The theatre file.")],
    count: Annotated[
        int | None, Option(min=1, help="Readings to show; without it until Ctrl-C, or one if piped.")
    ] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Show a device's readings as a live table. Arms are only read, and do not move.

    With --json one object a line for each reading. A tracker and cameras are switched on for this. Exit
    codes: 0 done, 2 usage or a bad file, 3 a run uses the theatre, 4 the device does not answer.
    """
    from procedures.runs.theatre_lock import require_free_theatre
    from ronna_hw.theatre import Theatre

    require_free_theatre(config)
    wanted = count if count is not None or terminal.on_terminal(sys.stdout) else 1
    with Theatre.from_file(config) as theatre:
        if device not in theatre.file.devices:
            known = ", ".join(theatre.file.devices)
            meant = did_you_mean(device, theatre.file.devices) or "Name one of the tables."
            raise UsageMistake(f"{config} has no device {device!r}", expected=known, action=meant)
        with _readings(theatre, device) as readings:
            one = theatre.devices[device]
            axes = one.kinematics.axis_names if isinstance(one, RobotArm) else ()
            _show(device, islice(readings, wanted), axes, as_json=as_json)


@contextmanager
def _readings(theatre: Theatre, name: str) -> Iterator[Iterable[object]]:
    """Stream a device's readings; an arm stays as it is, other devices are active meanwhile."""
    one = theatre.devices[name]
    is_arm = isinstance(one, RobotArm)
    if not isinstance(one, StreamsReadings):
        raise UsageMistake(
            f"{name} has no readings",
            expected="a tracker, an arm or a pair of cameras",
            action="Name one of those; the driver of another device needs a method `stream`.",
        )
    one.connect()
    if is_arm:
        yield one.stream()
        return
    one.configure()
    with one.active():
        yield one.stream()


def _show(name: str, readings: Iterable[object], axes: Sequence[str], *, as_json: bool) -> None:
    if as_json or not terminal.takes_escapes(sys.stdout):
        for reading in readings:
            if as_json:
                sys.stdout.write(
                    json.dumps({"device": name, **_stamp(reading), "rows": tabulate_reading(reading, axes)})
                    + "\n"
                )
                sys.stdout.flush()  # into a pipe too
            else:
                heads, lines = _columns(tabulate_reading(reading, axes))
                terminal.print_table(name, heads, lines)
        return
    from rich.live import Live

    with Live(refresh_per_second=SHOWN_PER_S) as live:
        for reading in readings:
            live.update(_table(name, tabulate_reading(reading, axes)))


def _stamp(reading: object) -> dict[str, object]:
    if not isinstance(reading, StampedReading):
        return {}
    stamp = reading.stamp
    return {
        "theatre_time_s": stamp.theatre_time_s,
        "device_clock": stamp.device_clock,
        "validity": reading.validity.value,
    }


def tabulate_reading(reading: object, axes: Sequence[str] = ()) -> Rows:
    """Return the rows of a reading: tools and strays, axes by name, or sides; numbers are not rounded."""
    match reading:
        case TrackerFrame():
            tools = [
                {"what": one.tool, "validity": one.validity.value, **_place(one.position_mm)}
                | {"fit_rms_mm": one.fit_error_mm}
                for one in reading.tools
            ]
            strays = [
                {"what": f"stray {number}", "validity": one.validity.value, **_place(one.position_mm)}
                for number, one in enumerate(reading.strays, 1)
            ]
            return [*tools, *strays] or [{"what": "nothing in view", "validity": reading.validity.value}]
        case ArmReading():
            commanded_rad = reading.commanded_rad or (None,) * len(reading.joints_rad)
            joints: Rows = [
                {
                    "what": axis,
                    "validity": reading.validity.value,
                    "measured_deg": math.degrees(measured),
                    "commanded_deg": None if sent is None else math.degrees(sent),
                }
                for axis, measured, sent in zip(axes, reading.joints_rad, commanded_rad, strict=True)
            ]
            if reading.force_N is not None:
                joints.append({"what": "force on the tool", "force_N": math.hypot(*reading.force_N)})
            return joints
        case StereoReading():
            return [
                {"what": side, "validity": reading.validity.value, **_grey(image)}
                for side, image in (("left", reading.left), ("right", reading.right))
            ]
        case _:
            return [{"what": str(reading)}]


def _place(position_mm: Sequence[float] | None) -> dict[str, object]:
    return dict(zip(("x_mm", "y_mm", "z_mm"), position_mm or (None,) * 3, strict=True))


def _grey(image: CameraImage | None) -> dict[str, object]:
    if image is None:
        return {"mean_grey": None, "largest_grey": None}
    return {"mean_grey": float(image.pixels.mean()), "largest_grey": int(image.pixels.max())}


def _columns(rows: Rows) -> tuple[list[str], list[list[str]]]:
    heads = list(dict.fromkeys(name for row in rows for name in row))
    return heads, [[_format(row.get(name)) for name in heads] for row in rows]


def _format(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.{DECIMALS}f}"
    return "" if value is None else str(value)


def _table(name: str, rows: Rows) -> Table:
    from rich.table import Table

    heads, lines = _columns(rows)
    table = Table(*heads, title=name)
    for line in lines:
        table.add_row(*line)
    return table
