"""`ronna-arm`: arm calibration and calibration checks."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

from procedures.cli.calibrating.options import CalibrationOptions, MeasuringOptions
from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.options import with_option_records

if TYPE_CHECKING:
    from procedures.engine.case import Case
    from ronna_hw.arm.clearance.bodies import Part
    from ronna_hw.devices.robot import RobotArm


class Carried(StrEnum):
    """Tool on the flange of the arm."""

    STEREO_HEAD = "head"
    GUIDE = "guide"


app = terminal.command_group(
    "ronna-arm",
    "The arm: calibrate its geometry with stationary spheres, check that the calibration still holds, "
    "lead it by hand; describe it to other programs.",
    example="ronna-arm calibrate --sim --scene mini",
)


@app.command("calibrate")
@with_option_records
def calibrate_arm(
    context: typer.Context,
    options: CalibrationOptions,
    looks: Annotated[int, typer.Option(min=60, max=300, help="Measurements for the identification.")] = 90,
    validation: Annotated[
        int, typer.Option(min=12, max=100, help="Further measurements, held out for validation.")
    ] = 24,
) -> None:
    """Identify links, joints, gravity, backlash and the head on the flange by measuring stationary spheres.

    The tracker locates the spheres. The arm moves after a confirmation. Exit codes: 0 done, 1 the
    measurements do not yield a calibration, 2 usage, 3 refused, 4 device not found, 5 link lost, 6 safety
    stop, 7 not confirmed, 130 interrupted.
    """
    options.calibrate(context, "arm", looks, validation)


@app.command()
@with_option_records
def check(
    options: MeasuringOptions,
    looks: Annotated[int, typer.Option(min=12, max=100, help="Measurements for the check.")] = 24,
) -> None:
    """Measure spheres from a few poses: does the arm still match its calibration record?

    With --sim the theatre has a calibrated arm. Exit codes: 0 it does, 3 it has changed or has no record,
    others as in `calibrate`.
    """
    from procedures.calibration.arm_check import check_arm
    from procedures.cli.calibrating.calibration import check_calibration
    from procedures.reporting.calibration_figures import ArmCheckFigures
    from procedures.runs.calibrations import ARM
    from procedures.runs.request import Measurement
    from procedures.steps.calibration.recipe import Calibrated, Recipe

    def judge(case: Case) -> tuple[ArmCheckFigures, Callable[[], None]]:
        for remark in ARM.remarks(case):
            terminal.tell(remark)
        result = check_arm(ARM.observed(case))
        return ArmCheckFigures.model_validate(result), result.require

    def show(figures: ArmCheckFigures) -> None:
        rows = [[one.name, one.value, one.verdict] for one in figures.table()]
        terminal.print_table(f"check of calibration {figures.calibration}", ["", "value", ""], rows)

    theatre = replace(options, calibrated=True).theatre()
    recipe = Recipe(of=Calibrated.ARM, looks=0, more=looks)
    measurement = Measurement(steps=recipe.steps, title="Check of the arm", recipe=recipe)
    request = replace(theatre, procedure=measurement)
    check_calibration(request, options.out, ARM.activity, judge, show, as_json=options.as_json)


@app.command()
def guide(
    config: Annotated[Path, typer.Option(exists=True, dir_okay=False, help="Theatre file with the arm.")],
    arm_name: Annotated[
        str, typer.Option("--arm", metavar="NAME", help="Which arm: NAME of [robot.NAME].")
    ] = "assistant",
    speed: Annotated[float, typer.Option(metavar="MM/S", min=1.0, max=50.0, help="Largest speed.")] = 50.0,
    reach: Annotated[
        float, typer.Option(metavar="MM", min=1.0, max=300.0, help="Farthest from where a push began.")
    ] = 150.0,
    force_limit: Annotated[
        float, typer.Option(metavar="N", min=10.0, max=100.0, help="Force at which the arm stops and holds.")
    ] = 60.0,
) -> None:
    """Lead an arm by hand while the space bar is held; q ends. It must sense force (Universal Robots).

    Before a case, never during one: where the arm is left becomes its home. Exit codes: 0 done, 3 refused or
    stopped by its force limit, others as in `calibrate`.
    """
    from procedures.cli.arm.guiding import guide as follow_hand
    from ronna_hw.devices.contact import HandGuidance

    limits = replace(HandGuidance(), speed_mm_s=speed, reach_mm=reach, force_limit_N=force_limit)
    follow_hand(config, arm_name, limits)


@app.command()
def urdf(
    name: Annotated[
        str,
        typer.Argument(metavar="ARM", help="Name of the arm: kr6, ur5 or ur5e, or a full one such as ur10e."),
    ],
    config: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Theatre file, for the head or guide on the flange.")
    ] = None,
    carrying: Annotated[
        Carried | None,
        typer.Option(help="With --config: the tool on the flange, as its record has it [head]."),
    ] = None,
) -> None:
    """Print the URDF of an arm: joints with their ranges, and the capsules that motions are checked against.

    For other programs; lengths in m. It is for kinematics and collision checks only: no masses and inertias,
    and an effort of 0. It is the nominal chain, without the deviations of a calibration record.
    Exit codes: 0 done, 2 usage, an unknown arm or a bad file.
    """
    from ronna_hw.arm.catalogue import ARMS, find_arm
    from ronna_hw.arm.urdf import write_urdf

    if config is None and carrying is not None:
        raise UsageMistake(
            f"--carrying {carrying} requires --config",
            expected="the theatre file with the tool's record",
            action="Add --config FILE, or omit --carrying: then the bare arm is printed.",
        )
    known = (arm for arm in ARMS.values() if arm.choice == name.casefold())  # as other commands name it
    arm = next(known, None) or find_arm(name)
    parts = () if config is None else _carried_parts(config, carrying or Carried.STEREO_HEAD, arm.name)
    sys.stdout.write(write_urdf(arm, parts))


def _carried_parts(config: Path, carrying: Carried, arm: str) -> Sequence[Part]:
    """Return the bodies of a tool in the frame of the flange, by the records of a theatre file.

    They hold for the arm of that theatre alone. Raises CLI-001 for another arm.
    """
    from procedures.workcell.ball_watcher import build_free_surroundings
    from ronna_hw.clock import HostClock
    from ronna_hw.config import read_theatre_file
    from ronna_hw.frames import Frame
    from ronna_hw.registry import make_device
    from ronna_hw.roles import MASTER

    theatre = read_theatre_file(config)
    if MASTER not in theatre.robot:
        raise UsageMistake(f"{config} has no robot.{MASTER}, which carries the tool")
    carries = cast("RobotArm", make_device(f"robot.{MASTER}", theatre.robot[MASTER], HostClock()))
    if (own := carries.kinematics.name) != arm:
        raise UsageMistake(
            f"the tool of {config} is on another arm",
            expected=own,
            got=arm,
            action=f"Name {own}, or omit --config for the arm without a tool.",
        )
    if theatre.calibration is None:
        raise UsageMistake(
            f"{config} has no calibration records, which say where the tool is on the flange",
            expected="the table [calibration]",
            action="Give the file of a theatre that was calibrated, or omit --config for the bare arm.",
        )
    head = carrying is Carried.STEREO_HEAD
    record = theatre.calibration.stereo_head if head else theatre.calibration.tool_tip
    bodies = theatre.cell.stereo_head if head else theatre.cell.guide
    flange_from_tool = record.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    return build_free_surroundings(theatre.cell, flange_from_tool, bodies).tool


def main() -> None:
    terminal.run(app)
