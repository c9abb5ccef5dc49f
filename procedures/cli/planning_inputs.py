"""Inputs of the planning commands: theatre arm, pose of the head, and CT."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from procedures.strategies.names import DEFAULT_STRATEGY, STRATEGY_NAMES
from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from procedures.imaging import Localization, Volume
    from procedures.journal.results import FramedPose
    from procedures.planning.plan_model import Plan
    from procedures.planning.theatre_arm import TheatreArm

READING_SHARE = 0.4  # of the progress bar; the rest is for localizing the markers
STRATEGY_HELP = "How the stereo head is oriented at the spheres. {}.".format(
    "; ".join(f"{name}: {meaning}" for name, meaning in STRATEGY_NAMES.items())
)
NEAREST_CT_MM = 10.0  # from base to CT frame, unless they are one; any theatre in metres would be closer
ONLY_THE_SIDE_TELLS = (
    "mirrored left and right, this plan would fit the CT as well: only the side tells whether it is "
    "right; for each trajectory compare with the CT on which side of the middle its entry is"
)
KUKA_ORDER = "X Y Z in mm, then A B C in deg about z, y and x, as KUKA's"
SixNumbers = tuple[float, float, float, float, float, float]

PlanArgument = Annotated[Path, Argument(metavar="PLAN", help="The plan.toml.")]
PlannedSeriesOption = Annotated[
    Path, Option("--ct", metavar="SERIES_DIR", help="Folder of the CT series it was planned on.")
]
StrategyOption = Annotated[
    str, Option(metavar="|".join(STRATEGY_NAMES), help=f"{STRATEGY_HELP} With --config.")
]
HeadOption = Annotated[
    SixNumbers | None,
    Option(metavar="X Y Z A B C", help=f"Pose of the CT frame in $ROBROOT, {KUKA_ORDER}; with --config."),
]
HomeOption = Annotated[
    SixNumbers | None,
    Option(
        metavar="A1 .. A6",
        help="Joint angles at which the arm starts, deg; with --config [default: those of the arm].",
    ),
]


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
            f"--strategy {strategy} needs --config and --robot-from-ct: it orients an arm's stereo head",
            action="Add both, or omit --strategy: without them no motion is checked.",
        )
    if config is None and robot_from_ct is None and home_deg is None:
        return
    if (config is None or robot_from_ct is None) and not chosen_later:
        options = {"--config": config, "--robot-from-ct": robot_from_ct, "--home": home_deg}
        given = [option for option, value in options.items() if value is not None]
        raise UsageMistake(
            "checking the motions needs both --config and --robot-from-ct",
            expected="both, or none of --config, --robot-from-ct and --home",
            got=" and ".join(given),
            action="Add the other, or omit these: then no motion is checked.",
        )
    for option, numbers in (("--robot-from-ct", robot_from_ct or ()), ("--home", home_deg or ())):
        if not all(math.isfinite(value) for value in numbers):
            raise UsageMistake(
                f"{option} needs finite numbers",
                got=" ".join(f"{value:g}" for value in numbers),
                action="Give each in mm or deg.",
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


def read_ct(
    series_dir: Path, needs_markers: bool, *, are_implanted: bool = True
) -> tuple[Volume, list[tuple[float, float, float]] | None, tuple[str, ...]]:
    """Read a series; return the volume, any marker centres, and remarks, such as why centres are missing."""
    volume, found, remarks = read_localized_ct(series_dir, needs_markers, are_implanted=are_implanted)
    centres_mm = None if found is None else [marker.centre_mm for marker in found.markers]
    return volume, centres_mm, remarks


def read_localized_ct(
    series_dir: Path, needs_markers: bool, *, are_implanted: bool = True
) -> tuple[Volume, Localization | None, tuple[str, ...]]:
    """Read a series; return the volume, any markers found in it, and remarks, such as why there are none."""
    from procedures.imaging import localize, read_series
    from procedures.imaging.scan_deformation import require_undeformed

    with terminal.progress_bar("reading the series") as advance:
        volume = read_series(series_dir, progress=lambda share: advance(share * READING_SHARE))
        if not (needs_markers or are_implanted):
            return volume, None, ()
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
    return volume, found, ()
