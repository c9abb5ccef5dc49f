"""Options of every calibration command, and the theatre that they name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from procedures.cli.case.scene_choice import LARGEST_SEED, SceneChoice
from ronna_hw.command_line.errors import UsageMistake

if TYPE_CHECKING:
    from procedures.cli.calibrating.calibration import CalibrationRequest
    from procedures.cli.case.request import TheatreRequest
    from ronna_hw.calibration import Numbers3

SimOption = Annotated[bool, typer.Option("--sim", help="Start a simulated theatre for this run.")]
SceneOption = Annotated[str, typer.Option(help="default, mini, or a scene file; with --sim.")]
SeedOption = Annotated[int, typer.Option(min=0, max=LARGEST_SEED, help="Seed of the simulated theatre.")]
ConfigOption = Annotated[
    Path | None, typer.Option(metavar="FILE", help="Theatre file with the endpoints to use.")
]
FirstDayOption = Annotated[
    bool,
    typer.Option(
        "--first-day", help="With --sim: frame and guide are as drawn, without records that are valid."
    ),
]
RecordsOption = Annotated[
    list[Path] | None,
    typer.Option(
        "--calibration",
        metavar="FOLDER",
        help="With --sim: records that a calibration left, instead of the theatre's own; repeatable.",
    ),
]
RecordedOption = Annotated[
    Path | None,
    typer.Option("--from", metavar="FOLDER", help="Compute again from the looks in this folder."),
]
DaysOption = Annotated[int, typer.Option(min=1, max=366, help="How long the records hold.")]
WriteOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write the theatre file with the new records, beside --config."),
]
AnswersOption = Annotated[
    Path | None, typer.Option(help="TOML file that answers the questions: a scripted operator.")
]
OutOption = Annotated[Path, typer.Option(help="Folder for what is written.")]


def calibration_request(
    *,
    sim: bool,
    scene: str,
    seed: int,
    config: Path | None,
    recorded: Path | None,
    write: Path | None,
    days: int,
    out: Path,
    as_json: bool,
    answers: Path | None = None,
    calibrated: bool = False,
    first_day: bool = False,
    records: Sequence[Path] = (),
) -> CalibrationRequest:
    """What the options ask for; raises CLI-001 unless looks and theatre file each come from one place."""
    one_theatre = sim != (config is not None)
    if (recorded is None and not one_theatre) or (recorded is not None and sim):
        raise UsageMistake("choose one: --sim, --config FILE, or --from FOLDER")
    if write is not None and config is None:
        raise UsageMistake("--write needs the theatre file it is made from: --config FILE")
    from procedures.cli.calibrating.calibration import CalibrationRequest

    theatre = None
    if recorded is None:
        theatre = theatre_request(
            sim,
            scene,
            seed,
            config,
            calibrated=calibrated,
            first_day=first_day,
            records=records,
            answers=answers,
        )
    return CalibrationRequest(theatre, recorded, config, write, days=days, out=out, as_json=as_json)


def theatre_request(
    sim: bool,
    scene: str,
    seed: int,
    config: Path | None,
    *,
    calibrated: bool = False,
    first_day: bool = False,
    records: Sequence[Path] = (),
    answers: Path | None = None,
) -> TheatreRequest:
    """The theatre that the options name, and who answers; raises CLI-001 unless it is one, PRO-026."""
    if sim == (config is not None):
        raise UsageMistake("choose one: --sim, or --config FILE")
    from procedures.cli.case.request import TheatreRequest
    from ronna_hw.config import read_theatre_file

    if config is not None:
        read_theatre_file(config)
    if config is not None and (first_day or records):
        raise UsageMistake("--first-day and --calibration go with --sim")
    if records:
        from procedures.cli.calibrating.files import require_records

        require_records(records)
    choice = SceneChoice(scene, seed, calibrated=calibrated, first_day=first_day, records=tuple(records))
    if sim:
        choice.check()
    scripted = None
    if answers is not None:
        from procedures.cli.case.answers import read_answers

        scripted = read_answers(answers)
    return TheatreRequest(config=config, choice=choice, answers=scripted)


def finite_ball(ball_mm: Numbers3 | None) -> Numbers3 | None:
    """The place of a ball as it was given. Raises CLI-001 for what is no number."""
    if ball_mm is not None and not all(map(math.isfinite, ball_mm)):
        got = " ".join(f"{value:g}" for value in ball_mm)
        raise UsageMistake("--ball needs three finite numbers", got=got)
    return ball_mm
