"""`ronna-procedure calibrate`: calibration of the mount's reference frame and the guide tip."""

from __future__ import annotations

from typing import Annotated

import typer

from procedures.cli.calibrating.options import CalibrationOptions
from ronna_hw.command_line.options import with_option_records
from ronna_hw.command_line.terminal import command_group

app = command_group(
    "calibrate",
    "Calibrate the mounted tools.",
    example="ronna-procedure calibrate tracker-frame --sim --scene mini",
)


@app.command("tracker-frame")
@with_option_records
def tracker_frame(
    context: typer.Context,
    options: CalibrationOptions,
    looks: Annotated[int, typer.Option(min=15, max=100, help="Poses for the calibration.")] = 30,
    validation: Annotated[
        int, typer.Option(min=5, max=50, help="Further poses, held out for validation.")
    ] = 10,
) -> None:
    """Find the tracked frame on the mount: the arm turns it in view of the tracker, which measures each pose.

    Nothing moves before a confirmation. Exit codes: 0 done, 1 the measurements do not yield a calibration, 2
    usage, 3 refused, 4 device not found, 5 link lost, 6 safety stop, 7 not confirmed, 130 interrupted.
    """
    options.calibrate(context, "tracker frame", looks, validation)


@app.command("tool-tip")
@with_option_records
def tool_tip(
    context: typer.Context,
    options: CalibrationOptions,
    ball: Annotated[
        tuple[float, float, float] | None,
        typer.Option(
            metavar="X Y Z",
            help="Position of the stand's ball in $ROBROOT, mm, to within 10 [default: the theatre file's].",
        ),
    ] = None,
    readings: Annotated[int, typer.Option(min=8, max=30, help="Orientations for the calibration.")] = 10,
    validation: Annotated[
        int, typer.Option(min=2, max=20, help="Further orientations, held out for validation.")
    ] = 3,
) -> None:
    """Find the guide's tip relative to the stereo head: the head measures a ball, then the tip pivots at its
    position.

    Nothing moves before a confirmation. Exit codes as in `tracker-frame`.
    """
    options.calibrate(context, "tool tip", readings, validation, ball)
