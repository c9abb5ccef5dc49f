"""`ronna-plan`: checks a plan against its CT series and the arm, proposes where markers go on a head."""

from __future__ import annotations

import math
import time
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple, cast

import typer

from ronna_hw.command_line import console
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from procedures.calibration.arm_sources import ErrorSizes
    from procedures.imaging import Volume
    from procedures.planning.check import PlanCheck
    from procedures.planning.motions import PreviewedMotion
    from procedures.planning.sight import StereoSight
    from procedures.planning.visits import ArmSetting
    from ronna_hw.collision_config import CollisionConfig
    from ronna_hw.devices import RobotArm
    from ronna_hw.tool_record import GuideBore

READING_SHARE = 0.4  # of the progress bar; the rest is for localizing the markers
SixNumbers = tuple[float, float, float, float, float, float]


class Theatre(NamedTuple):
    """The arm of a theatre file and its surroundings."""

    arm: ArmSetting
    cell: CollisionConfig
    sight: StereoSight
    bore: GuideBore


app = typer.Typer(
    name="ronna-plan",
    help="Check plans, and propose where markers go.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


@app.callback()
def plan() -> None:
    """Check plans, and propose where markers go."""


@app.command()
def check(
    plan_file: Annotated[Path, typer.Argument(metavar="PLAN", help="The plan.toml.")],
    series_dir: Annotated[
        Path,
        typer.Option("--ct", metavar="SERIES_DIR", help="Folder of the CT series it was planned on."),
    ],
    markers: Annotated[
        bool,
        typer.Option(
            "--markers",
            help="Check the motions to the markers too, and refuse a CT where none can be localized.",
        ),
    ] = False,
    config: Annotated[
        Path | None,
        typer.Option(
            "--config",
            metavar="FILE",
            help="Theatre file: check every motion of its arm.",
        ),
    ] = None,
    strategy: Annotated[
        str,
        typer.Option(
            metavar="ocs|thesis-ocs|nos|jdms|improved|best",
            help="How the stereo head is held at the markers; with --config and --markers.",
        ),
    ] = "ocs",
    robot_from_ct: Annotated[
        SixNumbers | None,
        typer.Option(
            metavar="X Y Z A B C", help="Pose of the CT frame in $ROBROOT, mm and deg; with --config."
        ),
    ] = None,
    home: Annotated[
        SixNumbers | None,
        typer.Option(
            metavar="A1 .. A6",
            help="Joint angles at which the arm starts, deg; with --config [default: 0 -75 99 0 66 180].",
        ),
    ] = None,
    as_json: console.JsonOption = False,
    verbose: console.VerboseOption = False,
    log_level: console.LogLevelOption = None,
) -> None:
    """Check a plan against its CT series and, given the pose of the head, every motion of the arm.

    The markers in the CT are counted as the procedure counts them. The motions are those of the procedure,
    from home to every target and back; with --markers also those of the stereo head to the markers. Each
    shows duration, joint ranges, smallest distance and distance from a singularity before anything moves.

    Exit codes: 0 the plan can be used, 1 it cannot, 2 usage or an unreadable file, 3 a target is out of reach
    or a path is blocked, 130 interrupted. All problems are reported at once.
    """
    console.set_up_logging(verbose)
    began_s = time.perf_counter()
    theatre = _theatre(config, robot_from_ct, home, strategy)
    from procedures.planning.check import check_plan
    from procedures.planning.plan_file import read_plan

    planned = read_plan(plan_file)
    volume, fiducials_mm, uncounted = _read_ct(series_dir, markers)
    result = check_plan(
        planned,
        volume,
        fiducials_mm=fiducials_mm,
        to_fiducials=markers,
        arm=theatre and _in_its_scene(theatre, volume, fiducials_mm),
        sight=theatre and theatre.sight,
        bore=theatre and theatre.bore,
    )
    result = replace(result, warnings=(*result.warnings, *uncounted))
    for sentence in (*volume.warnings, *result.warnings):
        console.tell(f"warning: {sentence}")
    if as_json:
        console.print_json({**result.as_payload(), "elapsed_s": round(time.perf_counter() - began_s, 3)})
    elif result.passed:
        _print_trajectories(result)
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
    scene: Annotated[
        Path | None,
        typer.Option("--scene", metavar="FILE", help="Output of `ronna-sim scene` instead of a CT."),
    ] = None,
    markers: Annotated[int, typer.Option("--markers", min=3, max=4, help="How many markers.")] = 4,
    margin_mm: Annotated[
        float,
        typer.Option(
            "--margin", metavar="MM", min=1.0, max=60.0, help="By which all distances differ at least."
        ),
    ] = 10.0,
    seed: Annotated[int, typer.Option("--seed", min=0, help="Of the places that are tried.")] = 0,
    as_json: console.JsonOption = False,
    verbose: console.VerboseOption = False,
    log_level: console.LogLevelOption = None,
) -> None:
    """Propose where three or four markers go on a head, for a template that the surgeon implants them by.

    All their distances differ by the margin, so that they cannot be taken for one another; among such places
    those with the least expected error in the middle of the head are taken. A plan names the template as
    `template_mm`; `ronna-sim scene --template` puts the markers on a simulated head.
    """
    console.set_up_logging(verbose)
    from procedures.planning.template import propose_template
    from procedures.planning.template_file import head_of_scene, write_template

    if (series_dir is None) == (scene is None):
        raise UsageMistake("the head comes from --ct or from --scene: give one of them")
    if out.exists():
        raise UsageMistake(f"{out} exists and is left as it is", action="Name a new file.")
    if scene is not None:
        found = propose_template(head_of_scene(scene), markers, margin_mm, seed=seed)
    else:
        from procedures.imaging import read_series
        from procedures.planning.head_shape import head_shape

        assert series_dir is not None
        with console.progress_bar("reading the series") as advance:
            volume = read_series(series_dir, progress=advance)
        found = propose_template(head_shape(volume), markers, margin_mm, volume=volume, seed=seed)
    write_template(out, found)
    if as_json:
        console.print_json(
            {**found.model_dump(mode="json", by_alias=True), "least_difference_mm": found.least_difference_mm}
        )
        return
    distances = ", ".join(f"{value:.1f}" for value in found.distances_mm)
    console.print_table(
        f"{out}: {markers} markers; their distances, {distances} mm, differ by"
        f" {found.least_difference_mm:.1f} mm or more",
        ["marker", "centre LPS mm", "post"],
        [
            [
                str(number),
                " ".join(f"{value:.1f}" for value in one.centre_mm),
                " ".join(f"{value:.3f}" for value in one.post),
            ]
            for number, one in enumerate(found.markers, start=1)
        ],
    )


def _theatre(
    config: Path | None, robot_from_ct: SixNumbers | None, home_deg: SixNumbers | None, strategy: str
) -> Theatre | None:
    """The theatre of a file with the head at the given pose; None when no option asks for it."""
    from procedures.strategies.catalogue import strategy_named

    chosen = strategy_named(strategy)
    if config is None and robot_from_ct is None and home_deg is None:
        return None
    if config is None or robot_from_ct is None:
        raise UsageMistake("checking the motions needs both --config and --robot-from-ct")
    for option, numbers in (("--robot-from-ct", robot_from_ct), ("--home", home_deg or ())):
        if not all(math.isfinite(value) for value in numbers):
            raise UsageMistake(
                f"{option} needs finite numbers", got=" ".join(f"{value:g}" for value in numbers)
            )
    from procedures.planning.sight import StereoSight
    from procedures.planning.visits import ArmSetting
    from procedures.workcell.tool_records import ToolRecords
    from procedures.workcell.workcell import MASTER
    from ronna_hw.arm.angles import radians6
    from ronna_hw.arm.motion.planning import require_in_range
    from ronna_hw.arm.pose import Pose
    from ronna_hw.clock import HostClock
    from ronna_hw.config import read_theatre_file
    from ronna_hw.frames import Frame, Transform
    from ronna_hw.registry import make_device

    theatre = read_theatre_file(config)
    if MASTER not in theatre.robot or theatre.calibration is None:
        raise UsageMistake(f"{config.name} needs robot.{MASTER} and a calibration to check reach")
    opens_nothing = make_device(f"robot.{MASTER}", theatre.robot[MASTER], HostClock())
    kinematics = cast("RobotArm", opens_nothing).kinematics
    start_rad = kinematics.home_rad if home_deg is None else radians6(*home_deg)
    require_in_range(kinematics, start_rad)
    pose = Pose.from_kuka(*robot_from_ct)
    arm = ArmSetting(
        kinematics=kinematics,
        robot_from_ct=Transform.of(
            Frame.ROBOT, Frame.CT, translation_mm=pose.position_mm, quaternion_wxyz=pose.quaternion()
        ),
        flange_from_tool=theatre.calibration.tool_tip.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL),
        strategy=chosen,
        flange_from_stereo=theatre.calibration.stereo_head.flange_from_tool.transform(
            Frame.FLANGE, Frame.TOOL
        ),
        start_rad=start_rad,
        approach_mm=theatre.procedure.standoff_mm,
        sizes=ErrorSizes.stated(theatre.procedure.arm_error_mm, theatre.procedure.tool_error_mm),
    )
    bore = ToolRecords.of(theatre).guide.bore
    return Theatre(arm, theatre.cell_with_tools, StereoSight.of(theatre.calibration.stereo_head), bore)


def _in_its_scene(
    theatre: Theatre, volume: Volume, fiducials_mm: list[tuple[float, float, float]] | None
) -> ArmSetting:
    """The arm with its surroundings and the head and markers of this CT. Raises PLAN-014."""
    from procedures.planning.head_shape import head_shape
    from procedures.planning.planning_scene import PlanningScene

    scene = PlanningScene(theatre.cell, head_shape(volume), tuple(fiducials_mm or ()))
    return replace(theatre.arm, scene=scene)


def _read_ct(
    series_dir: Path, needs_markers: bool
) -> tuple[Volume, list[tuple[float, float, float]] | None, tuple[str, ...]]:
    """The series, the centres of its markers and, where they cannot be had and need not be, why not."""
    from procedures.imaging import localize, read_series

    with console.progress_bar("reading the series") as advance:
        volume = read_series(series_dir, progress=lambda share: advance(share * READING_SHARE))
        try:
            found = localize(
                volume, progress=lambda share: advance(READING_SHARE + (1.0 - READING_SHARE) * share)
            )
        except RonnaError as refused:
            if needs_markers:
                raise
            why = f"the fiducials in the CT were not counted: {refused.code} {refused.what}"
            return volume, None, (why,)
    return volume, [tuple(marker.centre_mm.tolist()) for marker in found.markers], ()


def _print_trajectories(result: PlanCheck) -> None:
    rows = [
        [
            one.id,
            " ".join(f"{value:.1f}" for value in one.entry_mm),
            " ".join(f"{value:.1f}" for value in one.target_mm),
            f"{one.depth_mm:.1f}",
            f"{one.free_angle_deg:.0f}",
            f"{one.margin_mm:.2f}",
        ]
        for one in result.plan.trajectories
    ]
    console.print_table(
        f"plan accepted: {result.plan.implanted} fiducials, tool {result.plan.tool}",
        ["trajectory", "entry LPS mm", "target LPS mm", "depth mm", "free angle deg", "margin mm"],
        rows,
    )


def _print_motions(result: PlanCheck) -> None:
    turned = [f"{name} by {math.degrees(turn):+.0f} deg" for name, turn in result.turns_rad if turn]
    about = f"; rotated about the axis: {', '.join(turned)}" if turned else ""
    duration_s = sum(motion.preview.duration_s for motion in result.motions)
    console.print_table(
        f"motions of the arm, {duration_s:.0f} s in total{about}",
        ["from", "to", "kind", "s", "smallest distance mm", "head mm", "singularity", "A1..A6 deg"],
        [_motion_row(motion) for motion in result.motions],
    )


def _motion_row(motion: PreviewedMotion) -> list[str]:
    seen = motion.preview
    closest, head = seen.closest, seen.nearest_to_head_mm
    ranges = [f"{math.degrees(low):.0f}..{math.degrees(high):.0f}" for low, high in seen.joint_ranges_rad]
    return [
        motion.motion.start,
        motion.motion.end,
        motion.motion.kind,
        f"{seen.duration_s:.1f}",
        "-" if closest is None else f"{closest.distance_mm:.0f} {closest.first}, {closest.second}",
        "-" if head is None else f"{head:.0f}",
        f"{seen.singularity.least:.2f}",
        " ".join(ranges),
    ]


def main() -> None:
    """Entry point of the console script."""
    console.run(app)
