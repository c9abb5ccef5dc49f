"""The request of a run: its theatre and its procedure, and `request.json`, which keeps both.

`request.json` is the first file of a run's folder, on disk before anything else; `resume` begins with it.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from difflib import get_close_matches
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, JsonValue, ValidationError

from procedures.engine.errors import BadRequestFile, OtherProgram
from ronna_hw.bounded_input import InputRefused, parse_json, read_json_bytes, read_toml
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.config import describe_mistakes
from ronna_hw.evidence.named_files import REQUEST_FILE
from ronna_hw.records import write_whole

if TYPE_CHECKING:
    from procedures.engine.order import Steps
    from procedures.runs.answers import Answers
    from procedures.steps.calibration.recipe import Recipe
    from ronna_hw.config import Calibrations

PROGRAM = "ronna-hw"
NAMED = ("default", "mini")  # of the scenes that ronna-sim knows, those with a patient
LARGEST_SEED = 2**63 - 1  # what a journal's JSON keeps exactly everywhere

FREE = "free"  # screws of their own


@dataclass(frozen=True)
class SceneChoice:
    """Choices from which both the simulated theatre and its phantom are drawn."""

    scene: str = "default"
    seed: int = 0
    markers: int | None = None
    targets: int | None = None
    fiducials: str = FREE  # what the spheres stand on
    calibrated: bool = False  # the arm of the theatre, with a record of it; the patient is the same
    first_day: bool = False  # frame and guide of the theatre are as drawn, without valid records
    records: tuple[Path, ...] = ()  # folders of calibrations, instead of the theatre's own records

    def check(self) -> None:
        """Raise CLI-001 for a scene that is neither named nor a file; its reader checks the content."""
        if self.scene not in NAMED and not Path(self.scene).is_file():
            alike = get_close_matches(self.scene, NAMED, n=1)
            raise UsageMistake(
                f"there is no scene {self.scene!r}",
                expected=f"{' or '.join(NAMED)}, which have a patient, or the path of a scene file",
                action=f"Did you mean {alike[0]}?" if alike else "ronna-sim scene prints one to start from.",
            )

    def arguments(self) -> list[str]:
        """Return the options of `ronna-sim theatre` and `ronna-sim phantom`."""
        options = ["--scene", self.scene, "--seed", str(self.seed)]
        for name, value in (("--markers", self.markers), ("--targets", self.targets)):
            if value is not None:
                options += [name, str(value)]
        return options if self.fiducials == FREE else [*options, "--fiducials", self.fiducials]

    def theatre_arguments(self) -> list[str]:
        """Return the options of `ronna-sim theatre` alone."""
        options = self.arguments()
        if self.calibrated:
            options.append("--calibrated")
        if self.first_day:
            options.append("--first-day")
        for folder in self.records:
            options += ["--calibration", str(folder)]
        return options

    @property
    def own_seed(self) -> int:
        """Seed of the drawing; a scene file holds its own, and its reader checks the rest of it."""
        path = Path(self.scene)
        if not path.suffix:
            return self.seed
        try:
            is_json = path.suffix == ".json"
            content = parse_json(read_json_bytes(path)) if is_json else read_toml(path, InputRefused)
            return int(content.get("seed", 0))
        except (OSError, ValueError, AttributeError, TypeError, OverflowError):
            return self.seed


@dataclass(frozen=True, kw_only=True)
class CaseProcedure:
    """A clinical case, or the same on a phantom."""

    strategy: str = "ocs"
    measure_targets: bool = False  # on a phantom with a ball at each target; a simulated one brings them
    case: Path | None = None  # folder with ct/ and plan.toml, on configured endpoints
    plan: Path | None = None  # for the simulated patient, in place of its own
    keep_raw: bool = False  # pictures and tracker frames as files


@dataclass(frozen=True, kw_only=True)
class CalibrationProcedure:
    """A calibration, whose records are valid for `days`."""

    recipe: Mapping[str, JsonValue]  # as `Recipe` writes it
    days: int
    write: Path | None = None  # the theatre file with the new records


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """A check, or a single measurement. It has no request file, so nothing resumes it.

    `in_use` selects the records to work with, given those of the theatre; a replay needs the `recipe`.
    """

    steps: Steps
    title: str
    in_use: Callable[[Calibrations], Calibrations] = lambda of_theatre: of_theatre
    recipe: Recipe | None = None


@dataclass(frozen=True, kw_only=True)
class RunRequest:
    """A procedure and its theatre: a simulated one, or with `config` the file of configured endpoints."""

    procedure: CaseProcedure | CalibrationProcedure | Measurement | None = None  # None: not yet chosen
    config: Path | None = None
    choice: SceneChoice = field(default_factory=SceneChoice)
    speed: str = "max"
    faults: Path | None = None
    answers: Answers | None = None  # of a scripted operator

    @property
    def seed(self) -> int | None:
        """Seed of a simulated theatre; None on configured endpoints."""
        return self.choice.own_seed if self.config is None else None

    @property
    def case(self) -> CaseProcedure:
        """The procedure of a case; only for code that is reached by cases alone."""
        assert isinstance(self.procedure, CaseProcedure), "this is not a case"
        return self.procedure

    @property
    def calibration(self) -> CalibrationProcedure:
        """The procedure of a calibration; only for code that is reached by calibrations alone."""
        assert isinstance(self.procedure, CalibrationProcedure), "this is not a calibration"
        return self.procedure

    @property
    def measures_targets(self) -> bool:
        """Whether the phantom has a ball at each target, to be measured."""
        return isinstance(self.procedure, CaseProcedure) and self.procedure.measure_targets


class CalibrationFile(BaseModel):
    """A requested calibration."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    recipe: dict[str, JsonValue] = Field(description="What its steps are made from.")
    days: int = Field(ge=1, description="Validity of its records.")
    write: Path | None = Field(default=None, description="Theatre file to write, with the new records.")


class RequestFile(BaseModel):
    """Content of `request.json`, with absolute paths."""

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


def write_request(request: RunRequest, folder: Path) -> None:
    """Write the request into a new run folder, and return when it is on disk."""
    content = RequestFile(program=version(PROGRAM), **_theatre(request), **_procedure(request))
    write_whole(folder / REQUEST_FILE, content.model_dump_json(by_alias=True, indent=1).encode())
    for place in (folder, folder.parent):  # a name is on disk only when its folder is
        directory = os.open(place, os.O_RDONLY)
        try:
            os.fsync(directory)
        finally:
            os.close(directory)


def _theatre(request: RunRequest) -> dict[str, Any]:
    choice = request.choice
    drawn = {one.name: getattr(choice, one.name) for one in fields(choice)}
    return drawn | dict(
        scene=str(Path(choice.scene).resolve()) if Path(choice.scene).suffix else choice.scene,
        records=tuple(folder.resolve() for folder in choice.records),
        speed=request.speed,
        faults=request.faults and request.faults.resolve(),
        config=request.config and request.config.resolve(),
        answers=None if request.answers is None else request.answers.model_dump(mode="json"),
    )


def _procedure(request: RunRequest) -> dict[str, Any]:
    match request.procedure:
        case CaseProcedure() as case:
            return dict(
                strategy=case.strategy,
                measure_targets=case.measure_targets,
                keep_raw=case.keep_raw,
                case=case.case and case.case.resolve(),
                plan=case.plan and case.plan.resolve(),
            )
        case CalibrationProcedure(recipe=recipe, days=days, write=write):
            file = CalibrationFile(recipe=dict(recipe), days=days, write=write and write.resolve())
            return {"calibration": file}
        case _:
            raise AssertionError("only cases and calibrations are resumed")


def read_request(folder: Path) -> RunRequest:
    """Read the request of a run; raises PRO-034, and PRO-031 for another version of this program."""
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
    procedure: CaseProcedure | CalibrationProcedure
    if (asked := content.calibration) is not None:
        procedure = CalibrationProcedure(recipe=asked.recipe, days=asked.days, write=asked.write)
    elif content.strategy is not None:
        procedure = CaseProcedure(
            strategy=content.strategy,
            measure_targets=content.measure_targets,
            case=content.case,
            plan=content.plan,
            keep_raw=content.keep_raw,
        )
    else:
        raise BadRequestFile(f"{path} names neither the strategy of a case nor a calibration")
    return RunRequest(
        procedure=procedure,
        config=content.config,
        choice=SceneChoice(**{one.name: getattr(content, one.name) for one in fields(SceneChoice)}),
        speed=content.speed,
        faults=content.faults,
        answers=None if content.answers is None else _answers(path, content.answers),
    )


def _answers(path: Path, content: dict[str, JsonValue]) -> Answers:
    from procedures.runs.answers import Answers

    try:
        return Answers.model_validate(content)
    except ValidationError as error:
        raise BadRequestFile(f"{path}: {'; '.join(describe_mistakes(error, Answers))}") from error


def request_hash(folder: Path) -> dict[str, str]:
    """Return the hash of the request that a run began with, for the first line of its journal."""
    from ronna_hw.evidence.seal import sha256_of

    path = folder / REQUEST_FILE
    return {"request_sha256": sha256_of(path)} if path.exists() else {}
