"""What the command line asks for, and the folder that a run gets for it."""

from __future__ import annotations

import contextlib
import secrets
import shutil
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.request_file import REQUEST_FILE, write_request
from procedures.cli.case.scene_choice import SceneChoice
from procedures.engine.errors import CommandRefused, TheatreNotNoted
from procedures.journal.journal import JOURNAL_FILE
from procedures.workcell.errors import AnotherArm
from ronna_hw.command_line.errors import PathProblem
from ronna_hw.command_line.options import require_folder
from ronna_hw.errors import EXIT_USAGE, ConfigurationError, DataError
from ronna_hw.evidence.manifest import RECORDS_FOLDER
from ronna_hw.host.files import walk
from ronna_hw.log_output import LOG_FILE

if TYPE_CHECKING:
    from pydantic import JsonValue

    from procedures.cli.case.answers import Answers


@dataclass(frozen=True, kw_only=True)
class TheatreRequest:
    """The simulated theatre to start, or with `config` the theatre file of configured endpoints."""

    config: Path | None = None
    choice: SceneChoice = field(default_factory=SceneChoice)
    speed: str = "max"
    faults: Path | None = None
    measure_targets: bool = False  # on a phantom with a ball at each; a simulated one brings them
    answers: Answers | None = None  # of a scripted operator

    @property
    def seed(self) -> int | None:
        """Seed of a simulated theatre; None on configured endpoints."""
        return self.choice.own_seed if self.config is None else None


@dataclass(frozen=True, kw_only=True)
class CaseRequest(TheatreRequest):
    """A case on that theatre, with its runs in the folder `out`."""

    out: Path
    strategy: str = "ocs"
    case: Path | None = None  # folder with ct/ and plan.toml, with `config`
    plan: Path | None = None  # for the simulated patient, instead of the one that it brings
    keep_raw: bool = False  # pictures and frames as files


@dataclass(frozen=True, kw_only=True)
class CalibrationRun(TheatreRequest):
    """A calibration in that theatre, whose records hold for so many days."""

    recipe: Mapping[str, JsonValue]  # as `Recipe` writes it
    days: int
    write: Path | None = None  # the theatre file with the new records


def check_theatre(request: TheatreRequest) -> None:
    """Raise what can be known to be wrong of its file and its records: CFG-001, CAL-001, CAL-005.

    PRO-043 while another run has its devices.
    """
    from procedures.calibration.arm_check import require_record
    from procedures.cli.calibrating.files import require_records
    from procedures.engine.theatre_lock import require_free_theatre
    from ronna_hw.config import read_theatre_file

    require_records(request.choice.records)
    if request.config is not None:
        theatre = read_theatre_file(request.config)
        if request.choice.calibrated:
            require_record(theatre.calibration.arm if theatre.calibration else None)
        require_free_theatre(request.config)


def check_request(request: CaseRequest) -> None:
    """Raise what can be known to be wrong before a run folder is made."""
    from procedures.strategies.catalogue import strategy_named
    from ronna_hw.config import read_theatre_file
    from ronna_hw.theatre_kind import require_one_kind

    strategy_named(request.strategy)
    check_theatre(request)
    if request.config is not None:
        require_one_kind(read_theatre_file(request.config))
        case = request.case or Path()
        around = case.resolve().parent
        if case.resolve() == around / "ct" and (around / "plan.toml").exists():
            raise PathProblem(f"{case} is the ct folder of a case", action=f"Give the case folder, {around}.")
        for part in ("ct", "plan.toml"):
            path = case / part
            if not path.exists():
                raise PathProblem(f"{path} does not exist", expected="a case folder with ct/ and plan.toml")
        if request.answers is not None:
            from procedures.planning.plan_file import read_plan

            plan = read_plan(case / "plan.toml")
            request.answers.check_trajectories([one.id for one in plan.trajectories])
    if request.plan is not None:
        from procedures.planning.plan_file import read_plan

        planned = [one.id for one in read_plan(request.plan).trajectories]
        if request.answers is not None:
            request.answers.check_trajectories(planned)
    if request.faults is not None:
        from procedures.cli.case.fault_script import check_fault_script
        from procedures.steps.catalogue import clinical_steps

        check_fault_script(
            request.faults, [step.name for step in clinical_steps(measure_targets=request.measure_targets)]
        )


def new_run_folder(request: CaseRequest) -> Path:
    """Make `OUT/<run id>`; the id is the moment, the seed of a simulated case and four random hex digits."""
    require_folder(request.out)
    seed = "" if request.seed is None else f"s{request.seed}-"
    folder = request.out / f"{datetime.now(UTC):%Y%m%dT%H%M%S}-{seed}{secrets.token_hex(2)}"
    made = folder.with_name(f".{folder.name}")  # a run's folder is never seen without its request
    made.mkdir(parents=True)
    write_request(request, made)
    return made.rename(folder)


@contextlib.contextmanager
def run_folder(request: CaseRequest) -> Iterator[Path]:
    """A new run's folder for the length of the block; nothing is left of one that was forgotten in it."""
    made = [path for path in (request.out, *request.out.parents) if not path.exists()]
    folder = new_run_folder(request)
    try:
        yield folder
    finally:
        if not folder.exists():
            for path in made:
                with contextlib.suppress(OSError):  # another run has begun there meanwhile
                    path.rmdir()


def forget_if_refused(folder: Path, problem: BaseException) -> None:
    """Remove a run folder that was refused before its journal had a line: what it began is of no use."""
    refused = isinstance(problem, AnotherArm | ConfigurationError | DataError | TheatreNotNoted) or (
        isinstance(problem, CommandRefused) and problem.exit_code == EXIT_USAGE
    )
    journal = folder / JOURNAL_FILE
    begun = (journal.exists() and journal.stat().st_size) or any((folder / RECORDS_FOLDER).glob("*"))
    if refused and not begun:
        shutil.rmtree(folder, ignore_errors=True)


def forget_if_empty(folder: Path) -> None:
    """Remove a run folder in which nothing but the request and the log was written."""
    if not any(
        path.is_file() and not path.name.startswith((LOG_FILE, REQUEST_FILE)) for path, *_ in walk(folder)
    ):
        shutil.rmtree(folder, ignore_errors=True)
