"""Request file `request.json`: written first in a run's folder and read first by `resume`."""

from __future__ import annotations

from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, Field, JsonValue, ValidationError

from procedures.engine.errors import BAD_REQUEST_FILE, OTHER_PROGRAM
from procedures.engine.methods import CaseMethods
from procedures.journal.recorded_roles import RecordedRoles
from procedures.runs.fault_script import read_fault_lines
from procedures.runs.request import (
    DEFAULT_ARM,
    FREE,
    POLARIS,
    CalibrationProcedure,
    CaseProcedure,
    RunRequest,
    SceneChoice,
)
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.evidence.manifest import REQUEST_FILE, sha256_of
from ronna_hw.host.files import sync_folder
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.records import write_atomically
from ronna_hw.roles import ONE_ARM

if TYPE_CHECKING:
    from procedures.runs.answers import Answers

PROGRAM = "ronna-hw"


class CalibrationFile(BaseModel, frozen=True, extra="forbid"):
    """Calibration part of a request file."""

    recipe: dict[str, JsonValue] = Field(description="What its steps are made from.")
    days: int = Field(ge=1, description="Validity of its records.")
    update: bool = Field(default=False, description="Whether its records go into the theatre file.")


class RequestFile(BaseModel, frozen=True, extra="forbid"):
    """Contents of `request.json`, with absolute paths."""

    schema_version: Literal[1] = Field(default=1, alias="schema")
    program: str = Field(description="Version of the program that made the run.")
    scene: str = Field(description="Name of a scene, or a scene file.")
    seed: int = 0
    markers: int | None = None
    targets: int | None = None
    fiducials: str = FREE
    tracker: str = Field(default=POLARIS, description="How the simulated tracker is reached.")
    arm: str = DEFAULT_ARM
    assistant_arm: str = Field(default=DEFAULT_ARM, description="Of a case with two arms.")
    drill: bool = Field(default=False, description="Whether the assistant drills.")
    roles: RecordedRoles = ONE_ARM
    calibrated: bool = False
    first_day: bool = False
    records: tuple[Path, ...] = ()
    strategy: str | None = Field(default=None, description="Of a case.")
    methods: CaseMethods = Field(default=CaseMethods(), description="Localizer and matcher of a case.")
    measure_targets: bool = False
    intraoperative: bool = Field(default=False, description="Whether the clamped head is scanned.")
    keep_raw: bool = Field(
        default=False, description="Whether pictures and tracker frames are kept as files."
    )
    speed: str
    faults: Path | None = None
    fault_lines: tuple[str, ...] = Field(
        default=(), description="Lines of that fault script as they were when the run began."
    )
    config: Path | None = Field(default=None, description="Theatre file of configured endpoints.")
    case: Path | None = Field(default=None, description="Folder with ct/ and plan.toml, with `config`.")
    plan: Path | None = Field(default=None, description="Plan for the simulated patient.")
    ask: bool = Field(default=False, description="Whether a person answers, and does manual work by words.")
    by_step: bool = Field(default=False, description="Whether commands run its steps, as `step` does.")
    answers: dict[str, JsonValue] | None = Field(default=None, description="What the file of answers said.")
    calibration: CalibrationFile | None = Field(
        default=None, description="What to calibrate, if it is not a case."
    )


def write_request(request: RunRequest, folder: Path) -> None:
    """Write the request into a new run folder and flush it to disk."""
    content = RequestFile(program=version(PROGRAM), **_theatre(request), **_procedure(request))
    write_atomically(folder / REQUEST_FILE, content.model_dump_json(by_alias=True, indent=1).encode())
    for place in (folder, folder.parent):
        sync_folder(place)


def _select(source: object, record: type[Any]) -> dict[str, Any]:
    """Return the fields of a dataclass from an object that has them too."""
    return {one.name: getattr(source, one.name) for one in fields(record)}


def _theatre(request: RunRequest) -> dict[str, Any]:
    choice = request.choice
    return _select(choice, SceneChoice) | dict(
        scene=str(Path(choice.scene).resolve()) if Path(choice.scene).suffix else choice.scene,
        records=tuple(folder.resolve() for folder in choice.records),
        speed=request.speed,
        faults=request.faults and request.faults.resolve(),
        fault_lines=() if request.faults is None else read_fault_lines(request.faults),
        ask=request.ask,
        by_step=request.by_step,
        config=request.config and request.config.resolve(),
        answers=None if request.answers is None else request.answers.model_dump(mode="json"),
    )


def _procedure(request: RunRequest) -> dict[str, Any]:
    match request.procedure:
        case CaseProcedure() as case:
            return _select(case, CaseProcedure) | dict(
                case=case.case and case.case.resolve(), plan=case.plan and case.plan.resolve()
            )
        case CalibrationProcedure() as calibration:
            return {"calibration": CalibrationFile(**_select(calibration, CalibrationProcedure))}
        case _:
            raise AssertionError("only cases and calibrations are resumed")


def read_request(folder: Path) -> RunRequest:
    """Read the request of a run. Raises PRO-034, or PRO-031 for another version of this program."""
    path = folder / REQUEST_FILE
    try:
        content = RequestFile.model_validate_json(read_json_bytes(path))
    except OSError as error:
        raise BAD_REQUEST_FILE(f"{path} cannot be read: {error.strerror}") from error
    except ValidationError as error:
        raise BAD_REQUEST_FILE(f"{path}: {'; '.join(describe_mistakes(error))}") from error
    if content.program != version(PROGRAM):
        raise OTHER_PROGRAM(
            f"{folder.name} was made by another version", expected=version(PROGRAM), got=content.program
        )
    procedure: CaseProcedure | CalibrationProcedure
    if content.calibration is not None:
        procedure = CalibrationProcedure(**_select(content.calibration, CalibrationProcedure))
    elif content.strategy is not None:
        procedure = CaseProcedure(**_select(content, CaseProcedure))
    else:
        raise BAD_REQUEST_FILE(f"{path} names neither the strategy of a case nor a calibration")
    return RunRequest(
        procedure=procedure,
        config=content.config,
        choice=SceneChoice(**_select(content, SceneChoice)),
        speed=content.speed,
        faults=content.faults,
        ask=content.ask,
        by_step=content.by_step,
        answers=None if content.answers is None else _answers(path, content.answers),
    )


def _answers(path: Path, content: dict[str, JsonValue]) -> Answers:
    from procedures.runs.answers import Answers

    try:
        return Answers.model_validate(content)
    except ValidationError as error:
        raise BAD_REQUEST_FILE(f"{path}: {'; '.join(describe_mistakes(error, Answers))}") from error


def request_hash(folder: Path) -> dict[str, str]:
    """Return the hash of a run's request file for the first journal line."""
    path = folder / REQUEST_FILE
    return {"request_sha256": sha256_of(path)} if path.exists() else {}
