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
from ronna_hw.evidence.manifest import LASER_LINE_FILE
from ronna_hw.text import format_count

if TYPE_CHECKING:
    from procedures.engine.case import Case
    from procedures.relocalization import SphereImage
    from procedures.relocalization.light_plane import LineRecord
    from procedures.reporting.calibration_figures import BallFigures, HeadCheckFigures
    from procedures.workcell.stereo_look import Look
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
    options: CalibrationOptions,
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
    options.calibrate(context, "stereo head", poses, visits, ball)


@app.command()
@with_option_records
def check(
    baseline: Annotated[
        Path, typer.Option(metavar="FOLDER", help="Folder that `calibrate` wrote, or its baseline.json.")
    ],
    options: MeasuringOptions,
    visits: Annotated[int, typer.Option(min=2, max=20, help="Visits of each orientation.")] = 3,
    line: Annotated[
        Path | None,
        typer.Option(
            metavar="FOLDER",
            help="Also check the laser line in pictures NAME-left.png, NAME-right.png (without the line: "
            "NAME-left-dark.png, NAME-right-dark.png) [the first time its plane and width are recorded "
            "beside the baseline].",
        ),
    ] = None,
) -> None:
    """Measure the ball again from the eight orientations of the calibration: has a camera or mount moved?

    Detects a camera turned by 0.01 degrees. With --sim and without --calibration the theatre uses the
    baseline's calibration. Exit codes: 0 the head is unchanged, 3 it has changed or its
    calibration must not be used, 1 the ball is not in view, others as in `calibrate`.
    """
    theatre = options.theatre()
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
    from procedures.runs.calibrations import head_check_figures
    from procedures.runs.request import Measurement
    from procedures.steps.calibration.head_looks import VisitedBaseline
    from procedures.steps.calibration.recipe import head_check

    def in_use(theatre_records: Calibrations) -> Calibrations:
        if options.sim and not options.calibration:
            return theatre_records.model_copy(update={"stereo_head": recorded.stereo_head})
        return theatre_records

    def judge(case: Case) -> tuple[HeadCheckFigures, Callable[[], None]]:
        result = compare_with_baseline(case.get(VisitedBaseline).result.looks, recorded)
        return head_check_figures(result, recorded), result.require

    steps = head_check(recorded, visits)
    measurement = Measurement(steps=steps, title="Check of the stereo head", in_use=in_use)
    request = replace(theatre, procedure=measurement)
    activity = "measuring the ball"
    from procedures.engine.setting import now_to_second
    from procedures.relocalization.line_pictures import record_pictures

    measured = None  # before anything moves
    if line is not None:
        measured = record_pictures(line, recorded.stereo_head, now_to_second())
    check_calibration(request, options.out, activity, judge, _print_check, as_json=options.as_json)
    if measured is not None:
        _check_line(measured, file.with_name(LASER_LINE_FILE))


@app.command()
@with_option_records
def measure(
    options: MeasuringOptions,
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
    theatre = options.theatre()
    from procedures.cli.calibrating.calibration import run_with_bar
    from procedures.runs.finishing import finalize_run
    from procedures.runs.folders import hold_run, new_run_folder
    from procedures.runs.request import Measurement
    from procedures.steps.calibration.recipe import head_look, look_in_place
    from procedures.workcell.stereo_look import Look

    moves = find or options.sim or ball is not None
    steps = head_look(require_finite_ball(ball)) if moves else look_in_place()
    measurement = Measurement(steps=steps, title="A measurement of the stereo head")
    request = replace(theatre, procedure=measurement)
    folder = new_run_folder(request, options.out, "measure")
    with hold_run(folder), finalize_run(folder, with_truth=False):
        engine = run_with_bar(request, folder, "measuring with the stereo head")
        measured_look = engine.setting.memory.find(Look)
        assert measured_look is not None, "the last step keeps its measurement"
        if picture is not None:
            from procedures.workcell.stereo_look import pair_picture
            from ronna_hw.records import write_atomically

            write_atomically(picture, pair_picture(measured_look, height_px=LARGE_PICTURE_PX))
        from procedures.reporting.calibration_figures import write_figures

        write_figures(show_look(measured_look, as_json=options.as_json), folder)


def _check_line(measured: LineRecord, file: Path) -> None:
    """Compare plane and width of the laser line with their record, or record them for the first time.

    By a head that has just passed its own check: another's line must not become the record. Raises STE-018.
    """
    from procedures.calibration.observations import read_strict
    from procedures.relocalization.light_plane import LineRecord
    from ronna_hw.records import write_atomically

    pairs = f"laser line in {format_count(measured.lines, 'pair')} of pictures"
    if not file.exists():
        write_atomically(file, measured.model_dump_json(indent=1).encode())
        terminal.tell(f"{pairs}: width {measured.width_mm:.3f} mm, plane recorded in {file}")
        return
    recorded = read_strict(LineRecord, file)
    terminal.tell(f"record of the line: {recorded.origin}")
    shift_mm, turn_rad, widening = recorded.compare(measured)
    terminal.tell(
        f"{pairs}: plane shifted by {shift_mm:.3f} mm and turned by {1000 * turn_rad:.1f} mrad, "
        f"width {measured.width_mm:.3f} mm, changed by {widening:.0%}"
    )
    recorded.require_same(measured)


def _print_check(figures: HeadCheckFigures) -> None:
    """Print the results of the three tests in a check."""
    rows = []
    for sign in figures.signs:
        change, sigma = (" ".join(f"{value:.5f}" for value in each) for each in (sign.value, sign.sigma))
        test = [f"{sign.name}, {sign.unit}", change, sigma, f"{sign.statistic:.1f}", f"{sign.limit:.1f}"]
        rows.append([*test, "CHANGED" if sign.sounds else "unchanged"])
    headings = ["test", "change", "standard error", "chi-square", "limit", ""]
    repeatability = f"arm repeatability {1000 * figures.repeatability_mm:.0f} um per axis"
    terminal.print_table(f"{format_count(figures.looks, 'measurement')}; {repeatability}", headings, rows)


def show_look(view: Look, *, as_json: bool) -> BallFigures:
    """Print the ball in both images and in the tool frame; return the figures.

    Raises the look's error if it has no point.
    """
    from procedures.relocalization.errors import NoSphere, NotTrusted
    from procedures.reporting.calibration_figures import BallFigures, OutlineFigures

    point = view.point
    if view.left is None or view.right is None:
        raise view.problem or NoSphere("no ball was measured in this image pair")
    if not as_json:
        _print_outlines({"left": view.left, "right": view.right})
    if point is None:
        raise view.problem or NotTrusted("no ball was measured in this image pair")
    figures = BallFigures(
        position_mm=point.position_mm.tolist(),
        covariance_mm2=point.covariance_mm2.tolist(),
        ray_gap_mm=point.ray_gap_mm,
        radius_mm=point.radius_mm,
        left=OutlineFigures.model_validate(view.left),
        right=OutlineFigures.model_validate(view.right),
    )
    if as_json:
        terminal.print_json(figures.as_json())
        return figures
    headings = ["x y z mm", "standard error um", "ray gap um", "radius mm"]
    position = " ".join(f"{value:.4f}" for value in point.position_mm)
    sigma = " ".join(f"{1000 * value**0.5:.1f}" for value in point.covariance_mm2.diagonal())
    row = [position, sigma, f"{1000 * point.ray_gap_mm:.1f}", f"{point.radius_mm:.3f}"]
    terminal.print_table("the ball in the tool frame", headings, [row])
    return figures


def _print_outlines(sides: dict[str, SphereImage]) -> None:
    rows = []
    for side, one in sides.items():
        centre = f"{one.centre_px[0]:.3f} {one.centre_px[1]:.3f}"
        axes = f"{one.axes_px[0]:.2f} {one.axes_px[1]:.2f}"
        rim = [f"{one.rim_fraction:.0%}", f"{one.scatter_px:.3f}", f"{one.blur_px:.1f}", f"{one.quality:.2f}"]
        rows.append([side, centre, axes, *rim, str(one.status)])
    headings = ["camera", "centre px", "semi-axes px", "rim", "scatter px", "blur px", "quality", ""]
    terminal.print_table("the ball in both images", headings, rows)


def main() -> None:
    terminal.run(app)
