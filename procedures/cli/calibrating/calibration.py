"""One kind of calibration on the command line, and what running whichever kind has in common.

OUT/<name>-<id>/<looks file>    what was observed, kept before anything is computed; compute again with --from
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any, Generic, TypeVar

from procedures.calibration.errors import BadObservations
from procedures.calibration.observations import Measurements, read_strict, require_same_theatre
from procedures.cli.calibrating.files import (
    finished_figures,
    require_same_folder,
    write_records,
    write_theatre,
)
from procedures.cli.calibrating.running import new_folder, run_steps
from procedures.cli.case.leaving_report import leaving_report
from procedures.cli.case.request import CalibrationRun, TheatreRequest
from procedures.composition.procedure import Resumption
from procedures.engine.case import Case
from procedures.engine.engine import Engine
from procedures.engine.run_lock import held_run
from procedures.reporting.calibration_figures import RecordFigures, write_figures
from procedures.steps.calibration.recipe import Recipe
from ronna_hw.bounded_input import read_json_bytes
from ronna_hw.command_line import terminal
from ronna_hw.config import Calibrations, read_theatre_file
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.inspection import inspected
from ronna_hw.evidence.journal_reading import JOURNAL_FILE
from ronna_hw.records import write_whole

NOT_COMPARED = (
    "warning: without --config nothing was compared with the records in force: whether the measurements were "
    "made with these was not judged"
)
Looks = TypeVar("Looks", bound=Measurements)
Result = TypeVar("Result")


@dataclass(frozen=True)
class CalibrationKind(Generic[Looks, Result]):
    """What is observed, computed from it and kept.

    `observed` takes the looks out of a case whose steps are done, `remarks` what the operator should know of
    them; `in_use` says which records its steps work with, given the theatre's.
    """

    name: str
    title: str
    activity: str
    looks_type: type[Looks]
    looks_file: str
    observed: Callable[[Case], Looks]
    remarks: Callable[[Case], Sequence[str]]
    compute: Callable[[Looks, timedelta], Result]
    records: Callable[[Result], dict[str, Any]]
    figures: Callable[[Result], RecordFigures]
    in_use: Callable[[Calibrations], Calibrations] = lambda of_theatre: of_theatre
    keep: Callable[[Looks, Result, Path], None] = lambda _looks, _result, _folder: None

    def read_looks(self, path: Path) -> Looks:
        """Stored looks, from their file or folder. Raises CAL-005, PRO-033 if their run was changed."""
        file = path / self.looks_file if path.is_dir() else path
        looks = read_strict(self.looks_type, file)
        if (file.parent / JOURNAL_FILE).exists():
            run = inspected(file.parent, every_file=False).require_account()
            run.require_content(file.name, read_json_bytes(file))
        return looks

    def write_looks(self, looks: Looks, folder: Path) -> None:
        """Keep the looks, before anything is computed from them."""
        write_whole(folder / self.looks_file, looks.model_dump_json(by_alias=True, indent=1).encode())


@dataclass(frozen=True)
class CalibrationRequest:
    """What the command line asks of any kind: look in a theatre, or compute from recorded looks."""

    theatre: TheatreRequest | None
    recorded: Path | None
    config: Path | None
    write: Path | None
    days: int
    out: Path
    as_json: bool


def calibrate(kind: CalibrationKind[Looks, Result], recipe: Recipe, request: CalibrationRequest) -> None:
    """Look or read, compute, leave the files and show the figures. Raises CAL-002 to CAL-020, PRO-033."""
    theatre = request.theatre or TheatreRequest(config=request.config)
    if request.write is not None and theatre.config is not None:
        require_same_folder(theatre.config, request.write)  # before anything is measured
    run = CalibrationRun(
        config=theatre.config,
        choice=theatre.choice,
        answers=theatre.answers,
        recipe=recipe.model_dump(mode="json"),
        days=request.days,
        write=request.write,
    )
    if request.recorded is not None:
        recorded = kind.read_looks(request.recorded)
        result = computed(kind, run, recorded)
        folder = new_folder(request.out, kind.name)
        kind.write_looks(recorded, folder)
        leave(kind, run, recorded, result, folder)
        if run.config is None:
            terminal.tell(NOT_COMPARED)
    else:
        folder = new_folder(request.out, kind.name, run)
        with held_run(folder), leaving_report(folder, with_truth=False):
            looked(kind, recipe, run, folder)
    show(finished_figures(folder), folder, written=request.write, as_json=request.as_json)


def looked(
    kind: CalibrationKind[Looks, Result],
    recipe: Recipe,
    run: CalibrationRun,
    folder: Path,
    resumption: Resumption | None = None,
) -> None:
    """Observe, or go on with that, and conclude within the run."""
    observe(kind, recipe, run, folder, lambda looks: conclude(kind, run, looks, folder), resumption)


def conclude(kind: CalibrationKind[Looks, Result], run: CalibrationRun, looks: Looks, folder: Path) -> None:
    """Compute and leave the files, the looks first. Raises what `computed` raises."""
    kind.write_looks(looks, folder)
    leave(kind, run, looks, computed(kind, run, looks), folder)


def computed(kind: CalibrationKind[Looks, Result], run: CalibrationRun, looks: Looks) -> Result:
    """What the looks yield. Raises CAL-020 for looks of another theatre, and what the computation raises."""
    theatre = None if run.config is None else read_theatre_file(run.config).calibration
    if theatre is not None:
        require_same_theatre(looks, theatre)  # a computation may take minutes
    try:
        result = kind.compute(looks, timedelta(days=run.days))
    except RonnaError:
        raise
    except (ValueError, ArithmeticError) as error:  # the former also of a matrix
        raise BadObservations(f"nothing can be computed from these measurements: {error}") from error
    if theatre is not None:
        require_same_theatre(looks, theatre, kind.records(result))
    return result


def leave(
    kind: CalibrationKind[Looks, Result], run: CalibrationRun, looks: Looks, result: Result, folder: Path
) -> None:
    """Leave the files of a calibration, and the theatre file with its records."""
    kind.keep(looks, result, folder)
    write_records(kind.records(result), folder)
    write_figures(kind.figures(result), folder)
    if run.write is not None and run.config is not None:
        write_theatre(run.config, run.write, kind.records(result), looks.created)


def show(figures: RecordFigures, folder: Path, *, written: Path | None, as_json: bool) -> None:
    """The figures of a calibration that is finished, and the theatre file that was `written` with it."""
    if as_json:
        terminal.print_json({**figures.as_json(), "folder": str(folder)})
        return
    rows = [[one.name, one.value, one.spread] for one in figures.table()]
    terminal.print_table(f"calibration {figures.calibration}", ["", "value", "standard error"], rows)
    record_files = (
        f"written to {written}"
        if written
        else (
            "copy calibration.toml into the theatre file, or use --write; with --sim use "
            f"--calibration {folder}"
        )
    )
    terminal.tell(f"records in {folder}: {record_files}")
    for warning in figures.warnings():
        terminal.tell(f"warning: {warning}")


def observe(
    kind: CalibrationKind[Looks, Result],
    recipe: Recipe,
    theatre: TheatreRequest,
    folder: Path,
    conclude: Callable[[Looks], None],
    resumption: Resumption | None = None,
) -> None:
    """Run the steps and report their remarks; what `conclude` raises is how the run has ended."""

    def judge(engine: Engine) -> None:
        with bar.hidden():  # it would write over the messages
            report_remarks(kind, engine.case)
            conclude(kind.observed(engine.case))

    with terminal.progress_bar(kind.activity) as bar:
        run_steps(
            theatre,
            folder,
            recipe.steps,
            bar,
            title=kind.title,
            in_use=kind.in_use,
            recipe=recipe,
            judge=judge,
            resumption=resumption,
        )


def report_remarks(kind: CalibrationKind[Looks, Result], case: Case) -> None:
    """Why measurements are missing: reported before the computation, which may fail because they are."""
    for remark in kind.remarks(case):
        terminal.tell(remark)
