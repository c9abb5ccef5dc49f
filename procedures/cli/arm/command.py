"""`ronna-arm`: calibrate the arm, check that its calibration still holds."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from procedures.cli.calibrating.options import (
    AnswersOption,
    ConfigOption,
    DaysOption,
    OutOption,
    RecordedOption,
    SceneOption,
    SeedOption,
    SimOption,
    WriteOption,
    calibration_request,
    theatre_request,
)
from ronna_hw.command_line import console

if TYPE_CHECKING:
    from procedures.calibration.arm.check import ArmCheck
    from procedures.calibration.arm.looks import ArmLooks

app = typer.Typer(
    name="ronna-arm",
    help="The arm: calibrate its geometry by spheres at rest, check that the calibration still holds.",
    epilog="Example: ronna-arm calibrate --sim --scene mini",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


@app.callback()
def arm() -> None:
    """The arm: calibrate its geometry by spheres at rest, check that the calibration still holds."""


@app.command("calibrate")
def calibrate_arm(
    sim: SimOption = False,
    scene: SceneOption = "default",
    seed: SeedOption = 0,
    config: ConfigOption = None,
    recorded: RecordedOption = None,
    looks: Annotated[int, typer.Option(min=60, max=300, help="Looks to identify the arm with.")] = 90,
    validation: Annotated[
        int, typer.Option(min=12, max=100, help="More looks, kept apart to judge the result by.")
    ] = 24,
    days: DaysOption = 30,
    write: WriteOption = None,
    answers: AnswersOption = None,
    out: OutOption = Path("calibrations"),
    as_json: console.JsonOption = False,
) -> None:
    """Identify links, joints, gravity, backlash and the head on the flange from looks at spheres at rest.

    The tracker says where the spheres are. The arm moves, after a confirmation. Exit codes: 0 done, 1 the
    looks do not give a calibration, 2 usage, 3 refused, 4 device not found, 5 link lost, 6 safety stop, 7 not
    confirmed, 130 interrupted.
    """
    request = calibration_request(
        sim=sim,
        scene=scene,
        seed=seed,
        config=config,
        recorded=recorded,
        write=write,
        days=days,
        out=out,
        as_json=as_json,
        answers=answers,
    )
    from procedures.cli.arm.files import KIND
    from procedures.cli.calibrating.calibration import calibrate
    from procedures.steps.calibration.recipe import Calibrated, Recipe

    calibrate(KIND, Recipe(of=Calibrated.ARM, looks=looks, more=validation), request)


@app.command()
def check(
    sim: SimOption = False,
    scene: SceneOption = "default",
    seed: SeedOption = 0,
    config: ConfigOption = None,
    looks: Annotated[int, typer.Option(min=12, max=100, help="Looks to judge by.")] = 24,
    answers: AnswersOption = None,
    out: OutOption = Path("calibrations"),
    as_json: console.JsonOption = False,
) -> None:
    """Look at spheres from a few poses: is the arm still as its calibration record says?

    With --sim the theatre is a calibrated one. Exit codes: 0 it is, 3 it has changed or has no record, others
    as in `calibrate`.
    """
    from procedures.calibration.arm.check import check_arm
    from procedures.cli.arm import files
    from procedures.cli.arm.display import print_check
    from procedures.cli.calibrating.calibration import observe
    from procedures.cli.calibrating.files import write_payload
    from procedures.cli.calibrating.running import new_folder
    from procedures.cli.case.leaving_report import leaving_report
    from procedures.steps.calibration.recipe import Calibrated, Recipe

    results: list[ArmCheck] = []

    def conclude(observed: ArmLooks) -> None:
        results.append(check_arm(observed))
        write_payload(files.check_payload(results[0]), folder)
        results[0].require()

    request = theatre_request(sim, scene, seed, config, calibrated=True, answers=answers)
    folder = new_folder(out, "check")
    try:
        with leaving_report(folder, with_truth=False):
            recipe = Recipe(of=Calibrated.ARM, looks=0, more=looks)
            observe(files.CHECK, recipe, request, folder, conclude)
    finally:
        for result in results:
            if as_json:
                console.print_json(files.check_payload(result))
            else:
                print_check(result)


def main() -> None:
    """Entry point of the console script."""
    console.run(app)
