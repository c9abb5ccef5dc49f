"""`request.json`: the first file of a run's folder, on disk before anything else. `resume` begins with it."""

from __future__ import annotations

import os
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from procedures.cli.case.scene_choice import FREE, SceneChoice
from procedures.engine.errors import BadRequestFile, OtherProgram
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.records import write_whole

if TYPE_CHECKING:
    from procedures.cli.case.answers import Answers
    from procedures.cli.case.request import CalibrationRun, CaseRequest, TheatreRequest

REQUEST_FILE = "request.json"
PROGRAM = "ronna-hw"


class CalibrationFile(BaseModel):
    """What was asked for by a calibration."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    recipe: dict[str, JsonValue] = Field(description="What its steps are made from.")
    days: int = Field(ge=1, description="Validity of its records.")
    write: Path | None = Field(default=None, description="Theatre file to write, with the new records.")


class RequestFile(BaseModel):
    """What was asked for, with absolute paths."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    schema_version: Literal[1] = Field(default=1, alias="schema")
    program: str = Field(description="Version of the program that made the run.")
    scene: str = Field(description="Name of a scene, or a scene file.")
    seed: int = 0
    markers: int | None = None
    targets: int | None = None
    fiducials: str = FREE
    calibrated: bool = False
    first_day: bool = False
    records: tuple[Path, ...] = ()
    strategy: str | None = Field(default=None, description="Of a case.")
    measure_targets: bool = False
    keep_raw: bool = Field(
        default=False, description="Whether pictures and tracker frames are kept as files."
    )
    speed: str
    faults: Path | None = None
    config: Path | None = Field(default=None, description="Theatre file of configured endpoints.")
    case: Path | None = Field(default=None, description="Folder with ct/ and plan.toml, with `config`.")
    plan: Path | None = Field(default=None, description="Plan for the simulated patient.")
    answers: dict[str, JsonValue] | None = Field(default=None, description="What the file of answers said.")
    calibration: CalibrationFile | None = Field(
        default=None, description="What to calibrate, if it is not a case."
    )


def write_request(request: CaseRequest | CalibrationRun, folder: Path) -> None:
    """Write what was asked for into a new run folder, and have it on disk."""
    content = RequestFile(program=version(PROGRAM), **_theatre(request), **_procedure(request))
    write_whole(folder / REQUEST_FILE, content.model_dump_json(by_alias=True, indent=1).encode())
    for place in (folder, folder.parent):  # a name is on disk only when its folder is
        directory = os.open(place, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)


def _theatre(request: TheatreRequest) -> dict[str, Any]:
    choice = request.choice
    return dict(
        scene=str(Path(choice.scene).resolve()) if Path(choice.scene).suffix else choice.scene,
        seed=choice.seed,
        markers=choice.markers,
        targets=choice.targets,
        fiducials=choice.fiducials,
        calibrated=choice.calibrated,
        first_day=choice.first_day,
        records=tuple(folder.resolve() for folder in choice.records),
        measure_targets=request.measure_targets,
        speed=request.speed,
        faults=request.faults and request.faults.resolve(),
        config=request.config and request.config.resolve(),
        answers=None if request.answers is None else request.answers.model_dump(mode="json"),
    )


def _procedure(request: CaseRequest | CalibrationRun) -> dict[str, Any]:
    from procedures.cli.case.request import CaseRequest

    if isinstance(request, CaseRequest):
        return dict(
            strategy=request.strategy,
            keep_raw=request.keep_raw,
            case=request.case and request.case.resolve(),
            plan=request.plan and request.plan.resolve(),
        )
    write = request.write and request.write.resolve()
    return {"calibration": CalibrationFile(recipe=dict(request.recipe), days=request.days, write=write)}


def read_request(folder: Path) -> CaseRequest | CalibrationRun:
    """What was asked for; raises PRO-034, and PRO-031 for another version of this program."""
    from procedures.cli.case.request import CalibrationRun, CaseRequest

    path = folder / REQUEST_FILE
    try:
        content = RequestFile.model_validate_json(read_json_bytes(path))
    except OSError as error:
        raise BadRequestFile(f"{path} cannot be read: {error.strerror}") from error
    except ValidationError as error:
        raise BadRequestFile(f"{path}: {'; '.join(describe_mistakes(error))}") from error
    if content.program != version(PROGRAM):
        raise OtherProgram(
            f"{folder.name} was made by another version", expected=version(PROGRAM), got=content.program
        )
    answers = None if content.answers is None else _answers(path, content.answers)
    choice = SceneChoice(
        content.scene,
        content.seed,
        content.markers,
        content.targets,
        content.fiducials,
        content.calibrated,
        content.first_day,
        content.records,
    )
    if (asked := content.calibration) is not None:
        return CalibrationRun(
            config=content.config,
            choice=choice,
            speed=content.speed,
            answers=answers,
            recipe=asked.recipe,
            days=asked.days,
            write=asked.write,
        )
    if content.strategy is None:
        raise BadRequestFile(f"{path} names neither the strategy of a case nor a calibration")
    return CaseRequest(
        out=folder.parent,
        choice=choice,
        strategy=content.strategy,
        measure_targets=content.measure_targets,
        keep_raw=content.keep_raw,
        speed=content.speed,
        faults=content.faults,
        config=content.config,
        case=content.case,
        plan=content.plan,
        answers=answers,
    )


def _answers(path: Path, content: dict[str, JsonValue]) -> Answers:
    from procedures.cli.case.answers import Answers

    try:
        return Answers.model_validate(content)
    except ValidationError as error:
        raise BadRequestFile(f"{path}: {'; '.join(describe_mistakes(error, Answers))}") from error
