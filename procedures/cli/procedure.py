"""`ronna-procedure`: run a case, step through it, look at its steps, its state chart and its links."""

from __future__ import annotations

import sys
from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from procedures.cli.calibrating.options import FirstDayOption, RecordsOption
from procedures.cli.case.scene_choice import LARGEST_SEED, SceneChoice
from procedures.cli.console.options import (
    BindOption,
    CertificateOption,
    ConsoleOption,
    ConsolePortOption,
    KeyOption,
    console_request,
)
from procedures.cli.mount.command import app as calibrate_app
from procedures.cli.new_theatre.command import new_theatre
from procedures.cli.runs.commands import add_commands
from ronna_hw.command_line.console import (
    JsonOption,
    run,
)
from ronna_hw.command_line.errors import UsageMistake

if TYPE_CHECKING:
    from procedures.cli.case.answers import Answers
    from procedures.cli.case.request import CaseRequest

app = typer.Typer(
    name="ronna-procedure",
    help="The procedure of a frameless stereotactic robot, from the CT to the needle tip. "
    "Research software, not a medical device.",
    epilog="Example: ronna-procedure run --sim",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)


class FiducialChoice(StrEnum):
    """Kind of markers on the patient."""

    FREE = "free"
    XFRAME = "xframe"


class SpeedChoice(StrEnum):
    """Pace of the simulated theatre."""

    MAX = "max"
    REAL = "1"


SimOption = Annotated[bool, typer.Option("--sim", help="Start a simulated theatre for this run.")]
SceneOption = Annotated[str, typer.Option(help="default, mini, or a scene file.")]
SeedOption = Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Seed of everything drawn at random.")]
MarkersOption = Annotated[int | None, typer.Option(min=3, max=8, help="Spheres on the head (default 5).")]
TargetsOption = Annotated[int | None, typer.Option(min=1, max=10, help="Trajectories (default 3).")]
FiducialsOption = Annotated[
    FiducialChoice, typer.Option(help="What the spheres stand on: screws, or the x-shaped frame.")
]
StrategyOption = Annotated[
    str,
    typer.Option(
        metavar="ocs|thesis-ocs|nos|jdms|improved|best",
        help="How the tool is held while the spheres are localized.",
    ),
]
SpeedOption = Annotated[SpeedChoice, typer.Option(help="max: as fast as the devices go; 1: real time.")]
FaultsOption = Annotated[Path | None, typer.Option(help="Fault script for the simulated theatre.")]
CalibratedOption = Annotated[
    bool,
    typer.Option(
        "--calibrated", help="With a calibrated arm: --sim brings its record, --config must name one."
    ),
]
ConfigOption = Annotated[Path | None, typer.Option(help="Theatre file with the endpoints to use.")]
CaseOption = Annotated[Path | None, typer.Option(help="Folder with ct/ and plan.toml, with --config.")]
PlanOption = Annotated[
    Path | None, typer.Option(help="With --sim: follow this plan on the simulated patient, not its own.")
]
AnswersOption = Annotated[
    Path | None, typer.Option(help="TOML file that answers the questions of the case: a scripted operator.")
]
OutOption = Annotated[Path, typer.Option(help="Folder for runs; each run makes one subfolder.")]


@app.command("run")
def run_command(
    sim: SimOption = False,
    config: ConfigOption = None,
    case: CaseOption = None,
    plan: PlanOption = None,
    scene: SceneOption = "default",
    seed: SeedOption = 0,
    markers: MarkersOption = None,
    targets: TargetsOption = None,
    fiducials: FiducialsOption = FiducialChoice.FREE,
    strategy: StrategyOption = "ocs",
    measure_targets: Annotated[
        bool,
        typer.Option(
            "--measure-targets", help="On a phantom: measure a ball at each target, before the guide."
        ),
    ] = False,
    calibrated: CalibratedOption = False,
    first_day: FirstDayOption = False,
    calibration: RecordsOption = None,
    speed: SpeedOption = SpeedChoice.MAX,
    faults: FaultsOption = None,
    answers: AnswersOption = None,
    console: ConsoleOption = False,
    console_port: ConsolePortOption = 0,
    bind: BindOption = None,
    certificate: CertificateOption = None,
    key: KeyOption = None,
    keep_raw: Annotated[
        bool,
        typer.Option(
            "--keep-raw", help="Pictures, tracker frames and arm states as files in RUN/raw, at most 2 GB."
        ),
    ] = False,
    out: OutOption = Path("runs"),
    as_json: JsonOption = False,
) -> None:
    """Run the whole case and end with the errors at the targets and a report."""
    from procedures.cli.case.display import follow_case

    request = _request(
        sim=sim,
        strategy=strategy,
        measure_targets=measure_targets,
        config=config,
        case=case,
        plan=plan,
        scene=SceneChoice(
            scene,
            seed,
            markers,
            targets,
            fiducials.value,
            calibrated,
            first_day,
            tuple(calibration or ()),
        ),
        speed=speed,
        faults=faults,
        answers=answers,
        keep_raw=keep_raw,
        out=out,
    )
    follow_case(
        request,
        as_json=as_json,
        console=console_request(
            wanted=console, port=console_port, bind=bind, certificate=certificate, key=key
        ),
    )


@app.command("step")
def step_command(
    sim: SimOption = False,
    config: ConfigOption = None,
    case: CaseOption = None,
    plan: PlanOption = None,
    scene: SceneOption = "default",
    seed: SeedOption = 0,
    markers: MarkersOption = None,
    targets: TargetsOption = None,
    fiducials: FiducialsOption = FiducialChoice.FREE,
    strategy: StrategyOption = "ocs",
    speed: SpeedOption = SpeedChoice.MAX,
    faults: FaultsOption = None,
    answers: AnswersOption = None,
    console: ConsoleOption = False,
    console_port: ConsolePortOption = 0,
    bind: BindOption = None,
    certificate: CertificateOption = None,
    key: KeyOption = None,
    out: OutOption = Path("runs"),
) -> None:
    """Step through the case by hand, one command per line; help lists them."""
    from procedures.cli.case.stepping import step_through

    step_through(
        _request(
            sim=sim,
            strategy=strategy,
            config=config,
            case=case,
            plan=plan,
            scene=SceneChoice(scene, seed, markers, targets, fiducials.value),
            speed=speed,
            faults=faults,
            answers=answers,
            out=out,
        ),
        console_request(wanted=console, port=console_port, bind=bind, certificate=certificate, key=key),
    )


@app.command("steps")
def steps_command(as_json: JsonOption = False) -> None:
    """List the steps of the procedure and what each one needs."""
    from procedures.engine.step import Scope
    from procedures.steps.catalogue import CLINICAL_STEPS
    from ronna_hw.command_line.console import print_json, print_table

    if as_json:
        rows = [
            {
                "name": step.name,
                "title": step.title,
                "needs": list(step.needs),
                "per_trajectory": step.scope is not Scope.CASE,
                "moves": step.moves,
            }
            for step in CLINICAL_STEPS
        ]
        print_json({"steps": rows})
        return
    print_table(
        "Steps of the procedure",
        ("step", "what it does", "for each trajectory", "moves the arm", "needs"),
        [
            (
                step.name,
                step.title,
                "" if step.scope is Scope.CASE else "yes",
                "yes" if step.moves else "",
                ", ".join(step.needs),
            )
            for step in CLINICAL_STEPS
        ],
    )


@app.command("graph")
def graph_command() -> None:
    """Print the state chart of the procedure as mermaid text."""
    from procedures.engine.machine import mermaid
    from procedures.steps.catalogue import CLINICAL_STEPS

    sys.stdout.write(mermaid(CLINICAL_STEPS))


@app.command("doctor")
def doctor_command(
    config: ConfigOption = None,
    endpoint: Annotated[
        list[str] | None,
        typer.Option(
            "--endpoint",
            help="A tracker's line or a camera to check: serial:///dev/..., tcp://host:port or gev://host.",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Check this computer and, with --config, every device of a theatre file by its driver's own probe.

    A tracker's line is tried at every rate without changing anything: which unit replies, which bytes
    arrive, which program holds the port. A camera's address: which cameras are on its network, which
    application controls it, which packet size arrives. At the end one verdict for each device and one for a
    case: what `run` would refuse is said before. Tracker and cameras are switched on for that; nothing
    moves. Exit codes: 0 all is well, 4 a device, line or camera does not answer or is not ready, or a
    calibration record has expired.
    """
    from procedures.cli.doctor.report import examine, show
    from ronna_hw.command_line.console import progress_bar

    with progress_bar("probing the devices") as progress:
        report = examine(config, endpoint or (), progress)
    show(report, as_json=as_json)


def _request(
    *,
    sim: bool,
    strategy: str,
    measure_targets: bool = False,
    config: Path | None,
    case: Path | None,
    plan: Path | None,
    scene: SceneChoice,
    speed: SpeedChoice,
    faults: Path | None,
    answers: Path | None,
    out: Path,
    keep_raw: bool = False,
) -> CaseRequest:
    from procedures.cli.case.request import CaseRequest

    if sim == (config is not None):
        both = "--sim and --config do not go together" if sim else "give either --sim or --config"
        raise UsageMistake(both, action="See ronna-procedure run --help.")
    if config is not None and case is None:
        raise UsageMistake("--config needs --case", action="Give the folder with ct/ and plan.toml.")
    if config is None and case is not None:
        raise UsageMistake("--case goes with --config", action="A simulated case brings its own patient.")
    if config is not None and plan is not None:
        raise UsageMistake("--plan goes with --sim", action="With --config the plan stands in --case DIR.")
    drawn = replace(scene, calibrated=False)
    if config is not None and (drawn != SceneChoice() or faults is not None or speed is not SpeedChoice.MAX):
        raise UsageMistake(
            "--scene, --seed, --markers, --targets, --fiducials, --first-day, --calibration, --speed and "
            "--faults go with --sim",
            action="Leave them out: the theatre file names the devices of the theatre.",
        )
    drawn = replace(drawn, first_day=False, records=())
    if Path(scene.scene).suffix and drawn != SceneChoice(scene.scene):
        raise UsageMistake(
            "--seed, --markers, --targets and --fiducials do not go with a scene file",
            action="The file holds its own.",
        )
    if sim:
        scene.check()
    return CaseRequest(
        answers=_answers(answers),
        out=out,
        choice=scene,
        strategy=strategy,
        measure_targets=measure_targets,
        keep_raw=keep_raw,
        speed=speed.value,
        faults=faults,
        config=config,
        case=case,
        plan=plan,
    )


def _answers(path: Path | None) -> Answers | None:
    if path is None:
        return None
    from procedures.cli.case.answers import read_answers

    return read_answers(path)


add_commands(app)
app.add_typer(calibrate_app, name="calibrate")
app.command("new-theatre")(new_theatre)


def main() -> None:
    """Entry point of the console script."""
    run(app)


if __name__ == "__main__":
    main()
