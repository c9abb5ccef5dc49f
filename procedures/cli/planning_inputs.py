"""Inputs of the planning commands (theatre arm, CT, markers), and proposed marker positions."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from procedures.planning.errors import WRONG_SERIES
from procedures.strategies.names import DEFAULT_STRATEGY, STRATEGY_NAMES
from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.options import require_new
from ronna_hw.errors import RonnaError
from ronna_hw.records import write_atomically

if TYPE_CHECKING:
    from procedures.imaging import Volume
    from procedures.journal.results import FramedPose
    from procedures.planning.plan_model import Plan
    from procedures.planning.theatre_arm import TheatreArm
    from ronna_hw.marker_template import TemplateMarker

READING_SHARE = 0.4  # of the progress bar; the rest is for localizing the markers
STRATEGY_HELP = "How the stereo head is oriented at the spheres. {}.".format(
    "; ".join(f"{name}: {meaning}" for name, meaning in STRATEGY_NAMES.items())
)
NEAREST_CT_MM = 10.0  # from base to CT frame, unless they are one; any theatre in metres would be closer
KUKA_ORDER = "X Y Z in mm, then A B C in deg about z, y and x, as KUKA's"
SixNumbers = tuple[float, float, float, float, float, float]

PlanArgument = Annotated[Path, typer.Argument(metavar="PLAN", help="The plan.toml.")]
PlannedSeriesOption = Annotated[
    Path, typer.Option("--ct", metavar="SERIES_DIR", help="Folder of the CT series it was planned on.")
]
StrategyOption = Annotated[
    str,
    typer.Option(
        metavar="|".join(STRATEGY_NAMES),
        help=f"{STRATEGY_HELP} With --config.",
    ),
]
HeadOption = Annotated[
    SixNumbers | None,
    typer.Option(
        metavar="X Y Z A B C", help=f"Pose of the CT frame in $ROBROOT, {KUKA_ORDER}; with --config."
    ),
]
HomeOption = Annotated[
    SixNumbers | None,
    typer.Option(
        metavar="A1 .. A6",
        help="Joint angles at which the arm starts, deg; with --config [default: those of the arm].",
    ),
]

SceneOption = Annotated[
    Path | None,
    typer.Option("--scene", metavar="FILE", help="Output of `ronna-sim scene` instead of a CT."),
]
SpacingOption = Annotated[int, typer.Option("--seed", min=0, help="Spacing of the positions tried.")]


def load_theatre_arm(
    config: Path | None, robot_from_ct: SixNumbers | None, home_deg: SixNumbers | None, strategy: str
) -> TheatreArm | None:
    """Load the theatre's arm with the head at the given pose; return None if no option requires it."""
    require_theatre_options(config, robot_from_ct, home_deg, strategy)
    if config is None or robot_from_ct is None:
        return None
    from procedures.planning.theatre_arm import theatre_arm
    from procedures.strategies.catalogue import find_strategy

    return theatre_arm(config, robot_from_ct, home_deg, find_strategy(strategy))


def require_theatre_options(
    config: Path | None,
    robot_from_ct: SixNumbers | None,
    home_deg: SixNumbers | None,
    strategy: str,
    *,
    chosen_later: bool = False,
) -> None:
    """Raise CLI-001 for conflicting options, STR-002 for an invalid strategy.

    With `chosen_later` theatre file and pose may come from the planner's page.
    """
    from procedures.strategies.catalogue import find_strategy
    from ronna_hw.plausible import are_degrees

    find_strategy(strategy)
    if config is None and strategy != DEFAULT_STRATEGY and not chosen_later:
        raise UsageMistake(
            f"--strategy {strategy} needs --config and --robot-from-ct: it orients an arm's stereo head"
        )
    if config is None and robot_from_ct is None and home_deg is None:
        return
    if (config is None or robot_from_ct is None) and not chosen_later:
        raise UsageMistake("checking the motions needs both --config and --robot-from-ct")
    for option, numbers in (("--robot-from-ct", robot_from_ct or ()), ("--home", home_deg or ())):
        if not all(math.isfinite(value) for value in numbers):
            raise UsageMistake(
                f"{option} needs finite numbers", got=" ".join(f"{value:g}" for value in numbers)
            )
    if robot_from_ct is not None and 0.0 < (gap_mm := math.hypot(*robot_from_ct[:3])) < NEAREST_CT_MM:
        raise UsageMistake(
            f"--robot-from-ct: X Y Z puts the origin of the CT {gap_mm:.3g} mm from the centre of the base",
            expected=f"at least {NEAREST_CT_MM:g} mm",
            action="Give millimetres, not metres.",
        )
    if home_deg is not None and not are_degrees(home_deg):
        raise UsageMistake(
            "--home: all angles are within 2 pi",
            got=" ".join(f"{value:g}" for value in home_deg),
            action="Give degrees, not radians.",
        )


def read_assumed_pose(source: Path, plan: Plan) -> SixNumbers:
    """Return the pose of the CT in $ROBROOT from a run's registration or a scene file, in mm and deg.

    A registration with another CT is mentioned: its origin may lie elsewhere in the head. Raises PLAN-003,
    PLAN-016, EXC-005, and errors of reading the run.
    """
    from procedures.planning.scene_head import read_scene_pose
    from ronna_hw.arm.pose import Pose

    found = _read_registration(source, plan) if source.is_dir() else read_scene_pose(source, plan)
    return Pose.from_quaternion(found.translation_mm, found.quaternion_wxyz).to_kuka()


def _read_registration(folder: Path, plan: Plan) -> FramedPose:
    """Return a run's latest valid registration, fine or else coarse."""
    from procedures.exchange.errors import NO_REGISTRATION
    from procedures.reporting.run_reading import RunReading
    from procedures.runs.folders import require_run
    from procedures.steps.clinical.correspondence import Correspondence
    from procedures.steps.clinical.plan_check import CheckedPlan
    from procedures.steps.clinical.results import RegisteredRobot
    from ronna_hw.evidence.inspection import inspect_run

    require_run(folder)
    reading = RunReading.of(inspect_run(folder).require_unchanged())
    found = reading.find(RegisteredRobot) or reading.find(Correspondence)
    if found is None:
        raise NO_REGISTRATION(
            f"{folder.name} has no valid registration",
            action="Give a run that got past correspondence, or the scene file of a simulated theatre.",
        )
    checked = reading.find(CheckedPlan)
    if checked is not None and checked.plan.series_instance_uid != plan.series_instance_uid:
        terminal.tell(f"{folder.name} registered another CT: its origin may lie elsewhere in the head")
    return found.robot_from_ct


def require_one_head(series_dir: Path | None, scene: Path | None) -> None:
    """Raise CLI-001 unless the head comes from exactly one source."""
    if (series_dir is None) == (scene is None):
        raise UsageMistake("the head comes from --ct or from --scene: give one of them")


def read_volume(series_dir: Path) -> Volume:
    """Read a CT series, showing a progress bar."""
    from procedures.imaging import read_series

    with terminal.progress_bar("reading the series") as advance:
        return read_series(series_dir, progress=advance)


def read_ct(
    series_dir: Path, needs_markers: bool
) -> tuple[Volume, list[tuple[float, float, float]] | None, tuple[str, ...]]:
    """Read a series; return the volume, any marker centres, and remarks, such as why centres are missing."""
    from procedures.imaging import localize, read_series
    from procedures.imaging.scan_deformation import require_undeformed

    with terminal.progress_bar("reading the series") as advance:
        volume = read_series(series_dir, progress=lambda share: advance(share * READING_SHARE))
        try:
            found = localize(
                volume, progress=lambda share: advance(READING_SHARE + (1.0 - READING_SHARE) * share)
            )
            require_undeformed(found.deformation)
        except RonnaError as refused:
            if needs_markers:
                raise
            why = f"the fiducials in the CT were not counted: {refused.code} {refused.what}"
            return volume, None, (why,)
    return volume, [marker.centre_mm for marker in found.markers], ()


def propose_marker_places(
    plan_file: Path,
    out: Path,
    series_dir: Path | None,
    scene: Path | None,
    markers: int,
    error_mm: float,
    seed: int,
    *,
    as_json: bool,
) -> None:
    """Propose marker positions.

    Raises PLAN-001 to PLAN-003, PLAN-014, PLAN-016, PLAN-021, and errors of reading the series.
    """
    import tomli_w

    from procedures.planning.head_in_ct import fit_head
    from procedures.planning.marker_sites import propose_markers
    from procedures.planning.plan_file import read_plan
    from procedures.planning.scene_head import read_scene_head
    from procedures.reporting.pictures import marker_picture

    picture = out.with_suffix(".png")
    require_one_head(series_dir, scene)
    require_new(out, picture)
    plan = read_plan(plan_file)
    trajectories = [one.trajectory for one in plan.trajectories]
    volume: Volume | None = None
    if scene is not None:
        head = read_scene_head(scene, plan)
    else:
        assert series_dir is not None
        volume = read_volume(series_dir)
        if plan.series_instance_uid != volume.series_instance_uid:
            raise WRONG_SERIES(
                "the plan belongs to another CT series",
                expected=f"{plan.series_instance_uid} ({plan_file})",
                got=f"{volume.series_instance_uid} ({series_dir})",
            )
        head = fit_head(volume)
    found = propose_markers(head, trajectories, markers, error_mm, volume=volume, seed=seed)
    write_atomically(out, tomli_w.dumps(found.model_dump(mode="json", by_alias=True)).encode())
    write_atomically(picture, marker_picture(found, head, trajectories))
    if as_json:
        terminal.print_json({**found.model_dump(mode="json", by_alias=True), "picture": str(picture)})
        return
    print_markers(f"{out}: {len(found.markers)} markers", found.markers)
    terminal.print_table(
        f"expected from marker errors of {found.marker_error_mm:g} mm each",
        ["target", "rms mm", "random mm"],
        [[one.target, f"{one.expected_mm:.3f}", f"{one.usual_mm:.3f}"] for one in found.targets],
    )


def print_markers(title: str, markers: Sequence[TemplateMarker]) -> None:
    """Print each marker's position and post direction."""
    terminal.print_table(
        title,
        ["marker", "centre LPS mm", "post"],
        [
            [
                str(number),
                " ".join(f"{value:.1f}" for value in one.centre_mm),
                " ".join(f"{value:.3f}" for value in one.post),
            ]
            for number, one in enumerate(markers, start=1)
        ],
    )
