"""`ronna-plan`: a plan against the CT it was made on, and against the arm."""

from __future__ import annotations

import math
import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ronna_hw.command_line import console
from ronna_hw.command_line.errors import UsageMistake

if TYPE_CHECKING:
    from procedures.imaging import Volume
    from procedures.planning.check import PlanCheck
    from procedures.planning.reach import ArmSetting

READING_SHARE = 0.4  # of the work, when the markers are localized too
MASTER = "master"  # the arm that carries the tool, by its name in the theatre file

app = typer.Typer(
    name="ronna-plan",
    help="Check plans.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


@app.callback()
def plan() -> None:
    """Check plans."""


@app.command()
def check(
    plan_file: Annotated[Path, typer.Argument(metavar="PLAN", help="The plan.toml.")],
    series_dir: Annotated[
        Path, typer.Option("--ct", metavar="SERIES_DIR", help="Folder of the CT series it was made on.")
    ],
    markers: Annotated[
        bool, typer.Option("--markers", help="Localize the markers too and compare their number.")
    ] = False,
    config: Annotated[
        Path | None,
        typer.Option("--config", metavar="FILE", help="Theatre file: check the reach of its arm and tool."),
    ] = None,
    robot_from_ct: Annotated[
        tuple[float, float, float, float, float, float] | None,
        typer.Option(
            metavar="X Y Z A B C", help="Where the CT frame will lie in $ROBROOT, mm and deg; with --config."
        ),
    ] = None,
    as_json: console.JsonOption = False,
    verbose: console.VerboseOption = False,
) -> None:
    """Check a plan against its CT series and, when told where the head will be, against the arm's reach.

    Exit codes: 0 the plan can be used, 1 it cannot, 2 usage or an unreadable file, 3 the arm does not reach,
    130 interrupted. Everything that is wrong is reported at once.
    """
    console.set_up_logging(verbose)
    began_s = time.perf_counter()
    arm = _arm_setting(config, robot_from_ct)
    from procedures.planning.check import check_plan
    from procedures.planning.plan_file import read_plan

    planned = read_plan(plan_file)
    volume, fiducials_mm = _read_ct(series_dir, markers)
    result = check_plan(planned, volume, fiducials_mm=fiducials_mm, arm=arm)
    for sentence in (*volume.warnings, *result.warnings):
        console.tell(f"warning: {sentence}")
    if as_json:
        console.print_json({**result.as_payload(), "elapsed_s": round(time.perf_counter() - began_s, 3)})
    elif result.passed:
        _print_trajectories(result)
    result.require()


def _arm_setting(
    config: Path | None, robot_from_ct: tuple[float, float, float, float, float, float] | None
) -> ArmSetting | None:
    """The arm of a theatre file with the head at an assumed place; None when neither is given."""
    if config is None and robot_from_ct is None:
        return None
    if config is None or robot_from_ct is None:
        raise UsageMistake("the reach needs both --config and --robot-from-ct")
    if not all(math.isfinite(value) for value in robot_from_ct):
        raise UsageMistake(
            "--robot-from-ct needs finite numbers", last=" ".join(f"{value:g}" for value in robot_from_ct)
        )
    from procedures.planning.reach import ArmSetting
    from procedures.strategies.catalogue import strategy_named
    from ronna_hw.arm.model import ArmVariant, arm_model
    from ronna_hw.arm.pose import Pose
    from ronna_hw.config import read_theatre_file
    from ronna_hw.frames import Frame, Transform

    theatre = read_theatre_file(config)
    if MASTER not in theatre.robot or theatre.calibration is None:
        raise UsageMistake(f"{config.name} has no robot.{MASTER} or no calibration: no reach to check")
    variant = theatre.robot[MASTER].options.get("variant", ArmVariant.SIXX)
    if variant not in list(ArmVariant):
        raise UsageMistake(
            f"{config.name} names the arm variant {variant!r}", action=f"Use one of {', '.join(ArmVariant)}."
        )
    pose = Pose.from_kuka(*robot_from_ct)
    return ArmSetting(
        model=arm_model(variant),
        robot_from_ct=Transform.of(
            Frame.ROBOT, Frame.CT, translation_mm=pose.position_mm, quaternion_wxyz=pose.quaternion()
        ),
        flange_from_tool=theatre.calibration.tool_tip.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL),
        strategy=strategy_named("ocs"),
        flange_from_stereo=theatre.calibration.stereo_head.flange_from_tool.transform(
            Frame.FLANGE, Frame.TOOL
        ),
    )


def _read_ct(series_dir: Path, with_markers: bool) -> tuple[Volume, list[tuple[float, float, float]] | None]:
    from procedures.imaging import localize, read_series

    with console.progress_bar("reading the series") as advance:
        volume = read_series(
            series_dir, progress=lambda share: advance(share * (READING_SHARE if with_markers else 1.0))
        )
        if not with_markers:
            return volume, None
        found = localize(
            volume, progress=lambda share: advance(READING_SHARE + (1.0 - READING_SHARE) * share)
        )
    return volume, [tuple(marker.centre_mm.tolist()) for marker in found.markers]


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


def main() -> None:
    """Entry point of the console script."""
    console.run(app)
