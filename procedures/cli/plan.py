"""`ronna-plan`: plan checks against the CT series and the arm, and proposed marker positions."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from procedures.cli import planning_inputs
from procedures.cli.marker_places import choose_fiducials, marker_places, print_expected, template
from procedures.cli.place import place
from procedures.cli.plan_markups import from_markups, to_markups
from procedures.cli.plan_sheet import sheet
from procedures.strategies.names import DEFAULT_STRATEGY
from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import PATH_PROBLEM, UsageMistake
from ronna_hw.command_line.options import VERBOSE_FLAG, require_new
from ronna_hw.text import format_count

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume
    from procedures.planning.fiducial_choice import Fiducials
    from procedures.planning.head_in_ct import HeadEllipsoid
    from procedures.planning.motions import PreviewedMotion
    from procedures.planning.plan_check import PlanCheck
    from procedures.planning.plan_model import Plan
    from ronna_hw.tool_record import GuideBore

PLANNER = "console.planning.serving"
STOP_NOT_JUDGED = (
    "whether the depth stop fits on the instrument was not judged: the length of the guide is in the theatre "
    "file; give --config and --robot-from-ct"
)

app = terminal.command_group(
    "ronna-plan", "Draw, create and check plans, map positions for the cart, propose positions for markers."
)
app.command()(place)
app.command()(sheet)


@app.command()
def check(
    plan_file: planning_inputs.PlanArgument,
    series_dir: planning_inputs.PlannedSeriesOption,
    markers: Annotated[
        bool,
        Option(
            "--markers",
            help="Also check the motions to the markers, and refuse a CT in which none can be localized.",
        ),
    ] = False,
    config: Annotated[
        Path | None, Option("--config", metavar="FILE", help="Theatre file: check every motion of its arm.")
    ] = None,
    strategy: planning_inputs.StrategyOption = DEFAULT_STRATEGY,
    robot_from_ct: planning_inputs.HeadOption = None,
    home: planning_inputs.HomeOption = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """Check a plan against its CT series and, given the pose of the head, every motion of the arm.

    The markers in the CT are counted as in the procedure. The motions are those of the procedure, from home
    to every target and back; with --markers also those of the stereo head to the markers. Each is shown with
    duration, joint ranges, smallest clearance and distance from a singularity before anything moves.

    Exit codes: 0 the plan can be used, 1 it cannot, 2 usage or an unreadable file, 3 a target is out of reach
    or a path is blocked, 130 interrupted. All problems are reported at once.
    """
    began_s = time.perf_counter()
    theatre = planning_inputs.load_theatre_arm(config, robot_from_ct, home, strategy)
    from procedures.planning.head_in_ct import fit_head
    from procedures.planning.plan_check import check_plan, require_spheres
    from procedures.planning.plan_file import read_plan

    planned = read_plan(plan_file)
    require_spheres(planned)
    volume, fiducials_mm, uncounted = planning_inputs.read_ct(
        series_dir, markers, are_implanted=planned.implanted > 0
    )
    result = check_plan(
        planned,
        volume,
        fiducials_mm=fiducials_mm,
        to_fiducials=markers,
        arm=theatre.with_scene(volume, planned.fiducials, tuple(fiducials_mm or ())) if theatre else None,
        sight=theatre.sight if theatre else None,
        bore=theatre.bore if theatre else None,
        plan_name=str(plan_file),
        ct_name=str(series_dir),
    )
    head = fit_head(volume) if result.passed else None
    unjudged = () if theatre else (STOP_NOT_JUDGED,)
    result = replace(result, warnings=(*result.warnings, *uncounted, *unjudged), head=head)
    for sentence in (*volume.warnings, *result.warnings):
        terminal.tell(f"warning: {sentence}")
    expected = _expect_with_skin(planned, volume, fiducials_mm or ()) if result.passed else None
    if as_json:
        shown = {} if expected is None else {"expected": expected.as_payload()}
        terminal.print_json(
            {**result.as_payload(), **shown, "elapsed_s": round(time.perf_counter() - began_s, 3)}
        )
    elif head is not None:
        _print_trajectories(result, head, theatre.bore if theatre else None)
        if result.only_side_tells:
            terminal.tell(planning_inputs.ONLY_THE_SIDE_TELLS)
        if result.distances:
            _print_distances(result)
        if expected is not None:
            print_expected([expected])
        if result.motions:
            _print_motions(result)
    result.require()


def _expect_with_skin(
    plan: Plan, volume: Volume, spheres_mm: Sequence[tuple[float, float, float]]
) -> Fiducials | None:
    """Expect the errors of a plan that has the skin registered; None of another. Raises CT-028, SRF-002."""
    from procedures.imaging.ct_surface import find_skin
    from procedures.planning.fiducial_choice import expect_with_skin

    return expect_with_skin(find_skin(volume), spheres_mm, plan) if plan.fiducials.has_skin else None


app.command()(from_markups)
app.command()(to_markups)
app.command()(template)
app.command("markers")(marker_places)
app.command("fiducials")(choose_fiducials)


def _print_trajectories(result: PlanCheck, head: HeadEllipsoid, bore: GuideBore | None) -> None:
    from procedures.planning.guide import depth_stop_mm

    rows = []
    for one in result.plan.trajectories:
        points = (" ".join(f"{value:.1f}" for value in point) for point in (one.entry_mm, one.target_mm))
        stop = "-" if bore is None else f"{depth_stop_mm(result.plan, one, bore):.1f}"
        line = [one.id, head.side_of(one.entry_mm, one.target_mm), *points, f"{one.depth_mm:.1f}"]
        limits = [f"{one.free_angle_deg:.0f}", f"{one.margin_mm:.2f}"]
        rows.append([*line, f"{result.plan.standoff_mm:g}", stop, *limits])
    headings = ["trajectory", "side", "entry LPS mm", "target LPS mm", "depth mm"]
    headings += ["stand-off mm", "depth stop mm", "free angle deg", "margin mm"]
    title = f"plan accepted: {format_count(result.plan.implanted, 'fiducial')}, tool {result.plan.tool}"
    terminal.print_table(title, headings, rows)


def _print_distances(result: PlanCheck) -> None:
    headings = ["structure", "trajectory", "distance mm", "margin mm"]
    rows = [
        [one.structure, one.trajectory, f"{one.distance_mm:.1f}", f"{one.margin_mm:.1f}"]
        for one in result.distances
    ]
    terminal.print_table("structures that the trajectories avoid", headings, rows)


def _print_motions(result: PlanCheck) -> None:
    rotations = [f"{name} by {math.degrees(turn):+.0f} deg" for name, turn in result.turns_rad if turn]
    rotation_note = f"; rotated about the axis: {', '.join(rotations)}" if rotations else ""
    duration_s = sum(motion.preview.duration_s for motion in result.motions)
    terminal.print_table(
        f"motions of the arm, {duration_s:.0f} s in total{rotation_note}",
        ["from", "to", "kind", "s", "smallest distance mm", "head mm", "singularity", "A1..A6 deg"],
        [_motion_row(motion) for motion in result.motions],
    )


def _motion_row(motion: PreviewedMotion) -> list[str]:
    seen = motion.preview
    closest, head = seen.closest, seen.nearest_to_head_mm
    ranges_deg = ((math.degrees(low), math.degrees(high)) for low, high in seen.joint_ranges_rad)
    ranges = " ".join(f"{low:.0f}..{high:.0f}" for low, high in ranges_deg)
    distance = "-" if closest is None else f"{closest.distance_mm:.0f} {closest.first}, {closest.second}"
    line = [str(motion.motion.start), str(motion.motion.end), motion.motion.kind, f"{seen.duration_s:.1f}"]
    return [*line, distance, "-" if head is None else f"{head:.0f}", f"{seen.singularity.least:.2f}", ranges]


@app.command()
def new(
    series_dir: Annotated[Path, Argument(metavar="SERIES_DIR", help="Folder of the CT series.")],
    out: Annotated[Path, Option("--out", metavar="FILE", help="The plan file to write.")] = Path("plan.toml"),
) -> None:
    """Create a plan for a CT: series, patient position and spheres are filled in; you add the trajectories.

    Exit codes: 0 written, 1 the series is unusable, 2 usage, 3 no spheres, 130 interrupted.
    """
    from procedures.imaging.dicom.slice_headers import CT_FOLDER
    from procedures.planning.plan_file import PLAN_FILE, compose_plan
    from ronna_hw.records import write_atomically

    require_new(out)
    volume, centres_mm, _ = planning_inputs.read_ct(series_dir, needs_markers=True)
    assert centres_mm is not None, "it has raised"
    text = compose_plan(volume.series_instance_uid, volume.patient_position, centres_mm, series_dir.name)
    write_atomically(out, text.encode(), exclusive=True)
    terminal.say(f"{out}: {format_count(len(centres_mm), 'sphere')}; add the trajectories")
    case = series_dir.resolve().parent
    if series_dir.resolve().name == CT_FOLDER and out.resolve() != case / PLAN_FILE:
        terminal.say(
            f"it was written to {out.resolve()}; ronna-procedure run --case {case} expects it beside the "
            f"series, as {case / PLAN_FILE}"
        )
    terminal.say(f"then: ronna-plan check {out} --ct {series_dir}")


@app.command("open")
def open_plan(
    series_dir: Annotated[Path, Argument(metavar="CT_DIR", help="Folder of the CT series.")],
    plan_file: Annotated[
        Path | None,
        Option(
            "--plan", metavar="FILE", help="The plan, new or existing [default: plan.toml next to CT_DIR]."
        ),
    ] = None,
    config: Annotated[
        Path | None,
        Option(
            "--config",
            metavar="FILE",
            help="Theatre file: its arm is checked while you plan. The page also lists those of this folder.",
        ),
    ] = None,
    strategy: planning_inputs.StrategyOption = DEFAULT_STRATEGY,
    robot_from_ct: planning_inputs.HeadOption = None,
    home: planning_inputs.HomeOption = None,
    fusion: Annotated[
        Path | None,
        Option(
            "--fusion",
            metavar="FILE",
            help="Fusion by ronna-ct fuse: its other series can be shown, and targets be chosen in it.",
        ),
    ] = None,
    other: Annotated[
        Path | None, Option("--other", metavar="OTHER_DIR", help="Folder of the series fused by --fusion.")
    ] = None,
    port: Annotated[int, Option(min=0, max=65535, help="Port of the page; 0: any free one.")] = 0,
) -> None:
    """Plan in the browser: slices, markers, trajectories, checked while they are drawn. Runs until Ctrl-C.

    Without --robot-from-ct the reach is checked from the cart's proposed place, place.json next to the plan.
    The page's address, which includes a key, is printed on standard error.
    """
    from procedures.planning.plan_lock import find_planner
    from procedures.runs.console_link import check_console

    planning_inputs.require_theatre_options(config, robot_from_ct, home, strategy, chosen_later=True)
    check_console()
    if not series_dir.is_dir():
        raise PATH_PROBLEM(f"{series_dir} does not exist", expected="the folder of a CT series")
    if (fusion is None) != (other is None):
        raise UsageMistake(
            "--fusion and --other belong together",
            action="Give both, or neither: then the planner shows the CT alone.",
        )
    plan = (plan_file or series_dir.resolve().parent / "plan.toml").resolve()
    if (planner := find_planner(plan)) is not None:
        terminal.tell(f"{plan} is open in another planner, {planner}: read-only here until that one ends")
    request = {
        "series": str(series_dir.resolve()),
        "plan": str(plan),
        "folder": str(Path.cwd()),
        "port": port,
        "config": config and str(config.resolve()),
        "strategy": strategy,
        "robot_from_ct": robot_from_ct,
        "home_deg": home,
        "fusion": fusion and str(fusion.resolve()),
        "other": other and str(other.resolve()),
    }
    more = [VERBOSE_FLAG] if VERBOSE_FLAG in sys.argv else []
    os.execv(sys.executable, [sys.executable, "-P", "-m", PLANNER, json.dumps(request), *more])


def main() -> None:
    terminal.run(app)


if __name__ == "__main__":
    main()
