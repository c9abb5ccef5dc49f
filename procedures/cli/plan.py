"""`ronna-plan`: plan checks against the CT series and the arm, and proposed marker positions."""

from __future__ import annotations

import json
import math
import os
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from procedures.cli.place import place
from procedures.cli.planning_inputs import (
    HeadOption,
    HomeOption,
    PlanArgument,
    PlannedSeriesOption,
    SceneOption,
    SpacingOption,
    StrategyOption,
    load_theatre_arm,
    read_ct,
    read_volume,
    require_one_head,
    require_theatre_options,
)
from procedures.strategies.names import DEFAULT_STRATEGY
from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.command_line.options import VERBOSE_FLAG, require_new

if TYPE_CHECKING:
    from procedures.planning.head_in_ct import HeadEllipsoid
    from procedures.planning.motions import PreviewedMotion
    from procedures.planning.plan_check import PlanCheck
    from ronna_hw.tool_record import GuideBore

PLANNER = "console.planning.serving"
STOP_NOT_JUDGED = (
    "whether the depth stop fits on the instrument was not judged: the length of the guide is in the theatre "
    "file; give --config and --robot-from-ct"
)

app = typer.Typer(
    name="ronna-plan",
    help="Draw, create and check plans, map positions for the cart, propose positions for markers.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


@app.callback()
def plan() -> None:
    """Draw, create and check plans, map positions for the cart, propose positions for markers."""


app.command()(place)


@app.command()
def check(
    plan_file: PlanArgument,
    series_dir: PlannedSeriesOption,
    markers: Annotated[
        bool,
        typer.Option(
            "--markers",
            help="Also check the motions to the markers, and refuse a CT in which none can be localized.",
        ),
    ] = False,
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="Theatre file: check every motion of its arm."),
    ] = None,
    strategy: StrategyOption = DEFAULT_STRATEGY,
    robot_from_ct: HeadOption = None,
    home: HomeOption = None,
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
    theatre = load_theatre_arm(config, robot_from_ct, home, strategy)
    from procedures.planning.head_in_ct import fit_head
    from procedures.planning.plan_check import check_plan, require_spheres
    from procedures.planning.plan_file import read_plan

    planned = read_plan(plan_file)
    require_spheres(planned)
    volume, fiducials_mm, uncounted = read_ct(series_dir, markers)
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
    if as_json:
        terminal.print_json({**result.as_payload(), "elapsed_s": round(time.perf_counter() - began_s, 3)})
    elif head is not None:
        _print_trajectories(result, head, theatre.bore if theatre else None)
        if result.distances:
            _print_distances(result)
        if result.motions:
            _print_motions(result)
    result.require()


@app.command()
def template(
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="New file: the template, TOML.")],
    series_dir: Annotated[
        Path | None,
        typer.Option("--ct", metavar="SERIES_DIR", help="Folder of a CT series that shows the head's skin."),
    ] = None,
    scene: SceneOption = None,
    markers: Annotated[int, typer.Option("--markers", min=3, max=4, help="Number of markers.")] = 4,
    margin_mm: Annotated[
        float,
        typer.Option(
            "--margin", metavar="MM", min=1.0, max=60.0, help="Minimum difference between all distances."
        ),
    ] = 10.0,
    seed: SpacingOption = 0,
    as_json: terminal.JsonOption = False,
) -> None:
    """Propose positions for three or four markers on a head, for a template that guides their implantation.

    All their distances differ by the margin, so that they cannot be confused; among such layouts the one with
    the smallest expected error in the middle of the head is chosen. A plan names the template as
    `template_mm`; `ronna-sim scene --template` puts the markers on a simulated head.
    """
    from procedures.cli.planning_inputs import print_markers
    from procedures.planning.marker_sites import propose_template, write_template
    from procedures.planning.scene_head import read_scene_head

    require_one_head(series_dir, scene)
    require_new(out)
    if scene is not None:
        proposed = propose_template(read_scene_head(scene), markers, margin_mm, seed=seed)
    else:
        from procedures.planning.head_in_ct import fit_head

        assert series_dir is not None
        volume = read_volume(series_dir)
        proposed = propose_template(fit_head(volume), markers, margin_mm, volume=volume, seed=seed)
    write_template(out, proposed)
    if as_json:
        terminal.print_json(
            {
                **proposed.model_dump(mode="json", by_alias=True),
                "least_difference_mm": proposed.least_difference_mm,
            }
        )
        return
    distances = ", ".join(f"{value:.1f}" for value in proposed.distances_mm)
    print_markers(
        f"{out}: {markers} markers; their distances, {distances} mm, differ by at least "
        f"{proposed.least_difference_mm:.1f} mm",
        proposed.markers,
    )


@app.command(name="markers")
def marker_places(
    plan_file: Annotated[Path, typer.Argument(metavar="PLAN", help="Plan file with the trajectories.")],
    out: Annotated[
        Path, typer.Option("--out", metavar="FILE", help="New TOML file; a picture is written next to it.")
    ],
    series_dir: Annotated[
        Path | None, typer.Option("--ct", metavar="SERIES_DIR", help="CT series that shows the head's skin.")
    ] = None,
    scene: SceneOption = None,
    markers: Annotated[int, typer.Option("--markers", min=3, max=8, help="Number of markers.")] = 5,
    error_mm: Annotated[
        float,
        typer.Option(
            "--error", metavar="MM", min=0.001, max=5.0, help="Localization error of each marker, 3-D rms."
        ),
    ] = 0.1,
    seed: SpacingOption = 0,
    as_json: terminal.JsonOption = False,
) -> None:
    """Propose marker positions on the head that minimize the error at the planned targets.

    On free skin between forehead and vertex, clear of the trajectories. For comparison, the error with
    markers placed at random over the same skin is shown.
    """
    from procedures.cli.planning_inputs import propose_marker_places

    propose_marker_places(plan_file, out, series_dir, scene, markers, error_mm, seed, as_json=as_json)


def _print_trajectories(result: PlanCheck, head: HeadEllipsoid, bore: GuideBore | None) -> None:
    from procedures.planning.guide import depth_stop_mm

    rows = [
        [
            one.id,
            head.side_of(one.entry_mm, one.target_mm),
            " ".join(f"{value:.1f}" for value in one.entry_mm),
            " ".join(f"{value:.1f}" for value in one.target_mm),
            f"{one.depth_mm:.1f}",
            f"{result.plan.standoff_mm:g}",
            "-" if bore is None else f"{depth_stop_mm(result.plan, one, bore):.1f}",
            f"{one.free_angle_deg:.0f}",
            f"{one.margin_mm:.2f}",
        ]
        for one in result.plan.trajectories
    ]
    terminal.print_table(
        f"plan accepted: {result.plan.implanted} fiducials, tool {result.plan.tool}",
        [
            *("trajectory", "side", "entry LPS mm", "target LPS mm", "depth mm"),
            *("stand-off mm", "depth stop mm", "free angle deg", "margin mm"),
        ],
        rows,
    )


def _print_distances(result: PlanCheck) -> None:
    terminal.print_table(
        "structures that the trajectories avoid",
        ["structure", "trajectory", "distance mm", "margin mm"],
        [
            [one.structure, one.trajectory, f"{one.distance_mm:.1f}", f"{one.margin_mm:.1f}"]
            for one in result.distances
        ],
    )


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
    ranges = [f"{math.degrees(low):.0f}..{math.degrees(high):.0f}" for low, high in seen.joint_ranges_rad]
    return [
        str(motion.motion.start),
        str(motion.motion.end),
        motion.motion.kind,
        f"{seen.duration_s:.1f}",
        "-" if closest is None else f"{closest.distance_mm:.0f} {closest.first}, {closest.second}",
        "-" if head is None else f"{head:.0f}",
        f"{seen.singularity.least:.2f}",
        " ".join(ranges),
    ]


@app.command()
def new(
    series_dir: Annotated[Path, typer.Argument(metavar="SERIES_DIR", help="Folder of the CT series.")],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="The plan file to write.")] = Path(
        "plan.toml"
    ),
) -> None:
    """Create a plan for a CT: series, patient position and spheres are filled in; you add the trajectories.

    Exit codes: 0 written, 1 the series is unusable, 2 usage, 3 no spheres, 130 interrupted.
    """
    from procedures.imaging.dicom.slice_headers import CT_FOLDER
    from procedures.planning.plan_file import PLAN_FILE, compose_plan
    from ronna_hw.records import write_atomically

    require_new(out)
    volume, centres_mm, _ = read_ct(series_dir, needs_markers=True)
    assert centres_mm is not None, "it has raised"
    text = compose_plan(volume.series_instance_uid, volume.patient_position, centres_mm, series_dir.name)
    write_atomically(out, text.encode(), exclusive=True)
    terminal.say(f"{out}: {len(centres_mm)} spheres; add the trajectories")
    case = series_dir.resolve().parent
    if series_dir.resolve().name == CT_FOLDER and out.resolve() != case / PLAN_FILE:
        terminal.say(
            f"it was written to {out.resolve()}; ronna-procedure run --case {case} expects it beside the "
            f"series, as {case / PLAN_FILE}"
        )
    terminal.say(f"then: ronna-plan check {out} --ct {series_dir}")


@app.command("open")
def open_plan(
    series_dir: Annotated[Path, typer.Argument(metavar="CT_DIR", help="Folder of the CT series.")],
    plan_file: Annotated[
        Path | None,
        typer.Option(
            "--plan", metavar="FILE", help="The plan, new or existing [default: plan.toml next to CT_DIR]."
        ),
    ] = None,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            metavar="FILE",
            help="Theatre file: its arm is checked while you plan. The page also lists those of this folder.",
        ),
    ] = None,
    strategy: StrategyOption = DEFAULT_STRATEGY,
    robot_from_ct: HeadOption = None,
    home: HomeOption = None,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Port of the page; 0: any free one.")] = 0,
) -> None:
    """Plan in the browser: slices, markers, trajectories, checked while they are drawn. Runs until Ctrl-C.

    Without --robot-from-ct the reach is checked from the cart's proposed place, place.json next to the plan.
    The page's address, which includes a key, is printed on standard error.
    """
    from procedures.planning.plan_lock import find_planner
    from procedures.runs.console_link import check_console

    require_theatre_options(config, robot_from_ct, home, strategy, chosen_later=True)
    check_console()
    if not series_dir.is_dir():
        raise PATH_PROBLEM(f"{series_dir} does not exist", expected="the folder of a CT series")
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
    }
    more = [VERBOSE_FLAG] if VERBOSE_FLAG in sys.argv else []
    os.execv(sys.executable, [sys.executable, "-P", "-m", PLANNER, json.dumps(request), *more])


def main() -> None:
    terminal.run(app)


if __name__ == "__main__":
    main()
