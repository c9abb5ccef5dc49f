"""`ronna-arm`: calibrate the arm, check that its calibration still holds."""

from __future__ import annotations

from collections.abc import Callable
from datetime import timedelta
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
    require_one_source,
    theatre_request,
)
from ronna_hw.command_line import console

if TYPE_CHECKING:
    from procedures.calibration.arm.check import ArmCheck
    from procedures.calibration.arm.looks import ArmLooks
    from procedures.calibration.arm.record import ArmResult
    from procedures.cli.case.request import TheatreRequest
    from procedures.engine.engine import Engine
    from ronna_hw.config import Calibrations

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


@app.command()
def calibrate(
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
    verbose: console.VerboseOption = False,
    log_level: console.LogLevelOption = None,
) -> None:
    """Identify links, joints, gravity, backlash and the head on the flange from looks at spheres at rest.

    The tracker says where the spheres are. The arm moves, after a confirmation. Exit codes: 0 done, 1 the
    looks do not give a calibration, 2 usage, 3 refused, 4 device not found, 5 link lost, 6 safety stop, 7 not
    confirmed, 130 interrupted.
    """
    console.set_up_logging(verbose)
    require_one_source(sim=sim, config=config, recorded=recorded, write=write)
    from procedures.calibration.arm.record import calibrate_arm
    from procedures.cli.arm import files
    from procedures.cli.calibrating.files import write_theatre
    from procedures.cli.calibrating.running import concluded, new_folder

    observed = None if recorded is None else files.read_looks(recorded)
    request = None if recorded is not None else theatre_request(sim, scene, seed, config)
    folder = new_folder(out, "arm")

    def conclude(observed: ArmLooks) -> ArmResult:
        files.write_looks(observed, folder)
        result = calibrate_arm(observed, life=timedelta(days=days))
        files.write_result(result, folder)
        return result

    def look(then: Callable[[ArmLooks], None]) -> None:
        assert request is not None, "without recorded looks there is a theatre"
        _look(request, folder, (looks, validation), answers, then)

    result = concluded(folder, observed, look, conclude)
    if write is not None and config is not None:
        write_theatre(config, write, files.records_of(result))
    if as_json:
        console.print_json({**files.payload_of(result), "folder": str(folder)})
        return
    from procedures.cli.arm.display import print_calibration

    print_calibration(result, folder)


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
    verbose: console.VerboseOption = False,
    log_level: console.LogLevelOption = None,
) -> None:
    """Look at spheres from a few poses: is the arm still as its calibration record says?

    With --sim the theatre is a calibrated one. Exit codes: 0 it is, 3 it has changed or has no record, others
    as in `calibrate`.
    """
    console.set_up_logging(verbose)
    from procedures.calibration.arm.check import check_arm
    from procedures.cli.arm import files
    from procedures.cli.arm.display import print_check
    from procedures.cli.calibrating.files import write_payload
    from procedures.cli.calibrating.running import new_folder
    from procedures.cli.case.leaving_report import leaving_report

    results: list[ArmCheck] = []

    def conclude(observed: ArmLooks) -> None:
        results.append(check_arm(observed))
        write_payload(files.check_payload(results[0]), folder)
        results[0].require()

    request = theatre_request(sim, scene, seed, config, calibrated=True)
    folder = new_folder(out, "check")
    try:
        with leaving_report(folder, with_truth=False):
            _look(request, folder, (0, looks), answers, conclude)
    finally:
        for result in results:
            if as_json:
                console.print_json(files.check_payload(result))
            else:
                print_check(result)


def _look(
    request: TheatreRequest,
    folder: Path,
    numbers: tuple[int, int],
    answers: Path | None,
    conclude: Callable[[ArmLooks], None],
) -> None:
    """Look at the spheres; what `conclude` raises is how the run has ended."""
    from procedures.cli.calibrating.running import run_steps
    from procedures.steps.calibration.procedures import arm_looks
    from procedures.steps.calibration.sphere_looks import ObservedSpheres

    identifying = numbers[0] > 0

    def in_use(calibrations: Calibrations) -> Calibrations:
        """An arm is identified from its nominal geometry, whatever a former record says."""
        return calibrations.model_copy(update={"arm": None}) if identifying else calibrations

    def judge(engine: Engine) -> None:
        conclude(engine.case.get(ObservedSpheres).result.observed)

    title = "Calibration of the arm" if identifying else "Check of the arm"
    with console.progress_bar("looking at the spheres") as advance:
        engine = run_steps(
            request,
            folder,
            arm_looks(*numbers),
            advance,
            title=title,
            answers=answers,
            in_use=in_use,
            judge=judge,
        )
    for remark in engine.case.get(ObservedSpheres).result.remarks:
        console.tell(remark)


def main() -> None:
    """Entry point of the console script."""
    console.run(app)
