"""`ronna-stereo`: stereo head calibration, calibration checks, and ball measurement."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from procedures.cli.calibrating.options import CalibrationOptions, MeasuringOptions, require_finite_ball
from ronna_hw.command_line import terminal
from ronna_hw.command_line.options import with_option_records

if TYPE_CHECKING:
    from procedures.engine.case import Case
    from procedures.reporting.calibration_figures import HeadCheckFigures
    from ronna_hw.config import Calibrations

Triple = tuple[float, float, float]
LARGE_PICTURE_PX = 544  # half the sensor's rows

app = terminal.command_group(
    "ronna-stereo",
    "The stereo head: calibrate it, check its calibration, measure a ball.",
    example="ronna-stereo calibrate --sim --scene mini",
)

BallOption = Annotated[
    Triple | None,
    typer.Option(
        metavar="X Y Z",
        help="Position of the ball in $ROBROOT, mm, to within 10 mm [default: from the tracker].",
    ),
]


@app.command("calibrate")
@with_option_records
def calibrate_head(
    context: typer.Context,
    command_options: CalibrationOptions,
    ball: BallOption = None,
    poses: Annotated[
        int, typer.Option(min=60, max=400, help="Poses to measure from, besides those of the check.")
    ] = 60,
    visits: Annotated[int, typer.Option(min=2, max=20, help="Visits of each orientation of the check.")] = 3,
) -> None:
    """Calibrate both cameras and the head's tool frame with one ball, measured from 60 or more poses.

    The arm moves after a confirmation. Exit codes: 0 done, 1 the observations do not yield a calibration,
    2 usage, 3 refused, 4 device not found, 5 link lost, 6 safety stop, 7 not confirmed, 130 interrupted.
    """
    command_options.calibrate(context, "stereo head", poses, visits, ball)


@app.command()
@with_option_records
def check(
    baseline: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder that `calibrate` wrote, or its baseline.json.")
    ],
    command_options: MeasuringOptions,
    visits: Annotated[int, typer.Option(min=2, max=20, help="Visits of each orientation.")] = 3,
) -> None:
    """Measure the ball again from the eight orientations of the calibration: has a camera or mount moved?

    Detects a camera turned by 0.01 degrees. With --sim and without --calibration the theatre uses the
    baseline's calibration. Exit codes: 0 the head is unchanged, 3 it has changed or its
    calibration must not be used, 1 the ball is not in view, others as in `calibrate`.
    """
    theatre = command_options.theatre()
    from procedures.calibration import Baseline, compare_with_baseline
    from procedures.calibration.errors import NotTheBaseline
    from procedures.calibration.observations import read_strict
    from procedures.calibration.self_check import BASELINE_FILE

    file = baseline / BASELINE_FILE if baseline.is_dir() else baseline
    if baseline.is_dir() and not file.exists():
        raise NotTheBaseline(
            f"{baseline} has no {BASELINE_FILE}",
            action="Give the folder of a calibration that measured every orientation of the check twice.",
        )
    recorded = read_strict(Baseline, file)
    recorded.require_complete()
    from procedures.cli.calibrating.calibration import check_calibration
    from procedures.cli.stereo.display import print_check
    from procedures.runs.calibrations import head_check_figures
    from procedures.runs.request import Measurement
    from procedures.steps.calibration.head_looks import VisitedBaseline
    from procedures.steps.calibration.recipe import head_check

    def in_use(theatre_records: Calibrations) -> Calibrations:
        if command_options.sim and not command_options.calibration:
            return theatre_records.model_copy(update={"stereo_head": recorded.stereo_head})
        return theatre_records

    def judge(case: Case) -> tuple[HeadCheckFigures, Callable[[], None]]:
        result = compare_with_baseline(case.get(VisitedBaseline).result.looks, recorded)
        return head_check_figures(result, recorded), result.require

    steps = head_check(recorded, visits)
    measurement = Measurement(steps=steps, title="Check of the stereo head", in_use=in_use)
    request = replace(theatre, procedure=measurement)
    activity = "measuring the ball"
    check_calibration(
        request, command_options.out, activity, judge, print_check, as_json=command_options.as_json
    )


@app.command()
@with_option_records
def measure(
    command_options: MeasuringOptions,
    find: Annotated[
        bool, typer.Option("--find", help="First move the head over the ball; always with --sim.")
    ] = False,
    ball: BallOption = None,
    picture: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Write the image pair with the fitted outlines as PNG."),
    ] = None,
) -> None:
    """Take an image pair and show the fit of the ball: pixels, quality, position in the tool frame.

    Without --find and --ball nothing moves. Exit codes: 0 measured, 1 no ball in view, others as in
    `calibrate`.
    """
    theatre = command_options.theatre()
    from procedures.cli.calibrating.calibration import run_with_bar
    from procedures.runs.finishing import finalize_run
    from procedures.runs.folders import new_run_folder
    from procedures.runs.request import Measurement
    from procedures.steps.calibration.recipe import head_look, look_in_place
    from procedures.workcell.stereo_look import Look

    steps = (
        head_look(require_finite_ball(ball))
        if find or command_options.sim or ball is not None
        else look_in_place()
    )
    measurement = Measurement(steps=steps, title="A measurement of the stereo head")
    request = replace(theatre, procedure=measurement)
    folder = new_run_folder(request, command_options.out, "measure")
    with finalize_run(folder, with_truth=False):
        engine = run_with_bar(request, folder, "measuring with the stereo head")
        measured_look = engine.setting.memory.find(Look)
        assert measured_look is not None, "the last step keeps its measurement"
        if picture is not None:
            from procedures.workcell.stereo_look import pair_picture
            from ronna_hw.records import write_atomically

            write_atomically(picture, pair_picture(measured_look, height_px=LARGE_PICTURE_PX))
        from procedures.cli.stereo.display import show_look
        from procedures.reporting.calibration_figures import write_figures

        write_figures(show_look(measured_look, as_json=command_options.as_json), folder)


def main() -> None:
    terminal.run(app)
