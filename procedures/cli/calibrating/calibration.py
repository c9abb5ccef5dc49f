"""Calibration runs from the command line: measuring, recomputing, resuming, and display of the figures."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from procedures.cli.case.display import pause_on_interrupt
from procedures.cli.case.event_follower import EventFollower
from procedures.cli.case.operators import WritePrompt
from procedures.cli.case.staff import terminal_observers
from procedures.engine.events import Event, Progress, StepState
from procedures.reporting.calibration_figures import Figures, RecordFigures, write_figures
from procedures.runs.calibration_files import read_finished_figures
from procedures.runs.calibrations import (
    KINDS,
    CalibrationKind,
    Looks,
    Result,
    compute_calibration,
    conclude,
    finish_calibration,
    has_every_look,
    write_calibration_files,
)
from procedures.runs.finishing import complete_seal, finalize_run
from procedures.runs.folders import hold_run, new_run_folder
from procedures.runs.interrupted_run import InterruptedRun, Resumption
from procedures.runs.lifecycle import run_steps
from procedures.runs.observers import RunObservers
from procedures.runs.reopening import prepare_folder, require_ready_devices
from procedures.runs.request import RunRequest
from procedures.runs.request_checks import check_asking
from procedures.runs.theatre_lock import require_free_theatre
from procedures.steps.calibration.recipe import Recipe
from ronna_hw.command_line import terminal
from ronna_hw.command_line.messages import ProgressBar

if TYPE_CHECKING:
    from procedures.engine.case import Case
    from procedures.engine.engine import Engine

F = TypeVar("F", bound=Figures)
NOT_COMPARED = (
    "warning: without --config nothing was compared with the records in force: whether the measurements were "
    "made with these was not judged"
)


def calibrate(request: RunRequest, recorded: Path | None, out: Path, *, as_json: bool) -> None:
    """Run a calibration from new looks or those in `recorded`, write its files and show the figures.

    Raises CAL-002 to CAL-020, PRO-033.
    """
    kind = KINDS[Recipe.read(request.calibration.recipe).of]
    updated = request.config if request.calibration.update else None
    if recorded is not None:
        if updated is not None:
            require_free_theatre(updated)  # a run would find its records changed
        looks = kind.read_looks(recorded)
        result = compute_calibration(kind, request, looks)
        folder = new_run_folder(None, out, kind.name)
        kind.write_looks(looks, folder)
        write_calibration_files(kind, request, looks, result, folder)
        if request.config is None:
            terminal.tell(NOT_COMPARED)
    else:
        folder = new_run_folder(request, out, kind.name)
        with hold_run(folder), finalize_run(folder, with_truth=False):
            _measure(kind, request, folder)
    show(read_finished_figures(folder), folder, updated=updated, as_json=as_json)


def resume_calibration(
    request: RunRequest, interrupted: InterruptedRun, *, accepted: bool, as_json: bool
) -> None:
    """Resume an interrupted calibration and write its files; if already finished, just show its figures.

    Raises the errors of `resume`, and those of the calibration itself.
    """
    folder = interrupted.folder
    kind = KINDS[Recipe.read(request.calibration.recipe).of]
    if interrupted.finished:
        with complete_seal(interrupted):
            pass
        terminal.tell(f"{interrupted.run.name} is finished: nothing remains to be done")
    else:
        complete = has_every_look(request, interrupted)
        if not complete:
            check_asking(request, folder)
            require_ready_devices(request, folder)
        prepare_folder(interrupted)
        with finalize_run(folder, interrupted, with_truth=False):
            if complete:
                finish_calibration(kind, request, interrupted)
            else:
                _measure(kind, request, folder, Resumption(interrupted, accepted))
    updated = request.config if request.calibration.update else None
    show(read_finished_figures(folder), folder, updated=updated, as_json=as_json)


def _measure(
    kind: CalibrationKind[Looks, Result],
    request: RunRequest,
    folder: Path,
    resumption: Resumption | None = None,
) -> None:
    run_with_bar(
        request, folder, kind.activity, lambda case: conclude(kind, request, case, folder), resumption
    )


def run_with_bar(
    request: RunRequest,
    folder: Path,
    activity: str,
    conclude: Callable[[Case], None] = lambda _case: None,
    resumption: Resumption | None = None,
) -> Engine:
    """Run a calibration or measurement with a progress bar, then pass the case to `conclude`."""

    def conclude_run(engine: Engine) -> None:
        with bar.hidden():  # it would write over the messages
            conclude(engine.case)

    with terminal.progress_bar(activity) as bar:
        engine, _ = run_steps(request, folder, bar_observers(bar), resumption, conclude_run)
    return engine


def check_calibration(
    request: RunRequest,
    out: Path,
    activity: str,
    judge: Callable[[Case], tuple[F, Callable[[], None]]],
    show_figures: Callable[[F], None],
    *,
    as_json: bool,
) -> None:
    """Run a check, then write and show the figures from `judge`, even if the check fails."""
    checked_figures: list[F] = []

    def conclude(case: Case) -> None:
        figures, require = judge(case)
        write_figures(figures, folder)
        checked_figures.append(figures)
        require()

    folder = new_run_folder(request, out, "check")
    try:
        with hold_run(folder), finalize_run(folder, with_truth=False):
            run_with_bar(request, folder, activity, conclude)
    finally:
        for figures in checked_figures:
            if as_json:
                terminal.print_json(figures.as_json())
            else:
                show_figures(figures)


def bar_observers(bar: ProgressBar) -> RunObservers:
    """Return observers that show each step's own progress in `bar` and hide it during questions.

    Steps take seconds or an hour, so their number says nothing about the time left.
    """

    opened: list[Engine] = []

    def follow(engine: Engine) -> None:
        opened.append(engine)
        numbers = {str(key): number for number, key in enumerate(engine.order.sequence, 1)}

        def advance(events: Sequence[Event]) -> None:
            for event in events:
                match event.what:
                    case StepState(state="begun", step=step, title=title):
                        bar(0.0, f"{numbers[step]} of {len(numbers)}: {title}")
                    case Progress(share=share):
                        bar(share)
                    case _:
                        pass

        EventFollower(engine.events, advance)

    @contextmanager
    def asking() -> Iterator[WritePrompt]:
        # The bar would write over the question. Ctrl-C ends the command at once only between two questions.
        with bar.hidden(), pause_on_interrupt() as interrupts:
            for engine in opened:
                interrupts.attach(engine)
            with interrupts.asking() as write:
                yield write

    return terminal_observers(asking, follow)


def show(figures: RecordFigures, folder: Path, *, updated: Path | None, as_json: bool) -> None:
    """Show the figures of a finished calibration and the theatre file that was `updated`."""
    if as_json:
        terminal.print_json({**figures.as_json(), "folder": str(folder)})
        return
    rows = [[one.name, one.value, one.spread] for one in figures.table()]
    terminal.print_table(f"calibration {figures.calibration}", ["", "value", "standard error"], rows)
    record_files = (
        f"now in force in {updated}"
        if updated
        else f"not yet in force: repeat with --from {folder} --config FILE --update; with --sim use "
        f"--calibration {folder}"
    )
    terminal.tell(f"records in {folder}: {record_files}")
    for warning in figures.warnings():
        terminal.tell(f"warning: {warning}")
