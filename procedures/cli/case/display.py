"""What a person sees while a case runs, and at its end."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from procedures.cli.case.outcome import unfinished
from procedures.cli.case.pause import pause_on_interrupt
from procedures.cli.case.request import CaseRequest, check_request, forget_if_empty, new_run_folder
from procedures.cli.case.running import Watcher, run_case
from ronna_hw.command_line.console import message_console, on_terminal, print_json, print_table

if TYPE_CHECKING:
    from procedures.engine.result import StepResult
    from procedures.engine.step import Outcome, StepKey


@contextlib.contextmanager
def following(*, quiet: bool, verbose: bool) -> Iterator[Watcher]:
    """Follow a run: a live line on a terminal, one line per step with `verbose` elsewhere."""
    if quiet or not on_terminal(sys.stderr):
        yield Watcher(listener=_write_line) if verbose else Watcher()
        return
    from rich.progress import BarColumn, Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    console = message_console()
    bar = Progress(
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(bar_width=24),
        TimeElapsedColumn(),
        console=console,
        transient=True,
    )
    with pause_on_interrupt() as pause, bar:
        task = bar.add_task("starting", total=1.0)

        def progress(share: float, text: str) -> None:
            bar.update(task, completed=share, description=text)

        def listener(key: StepKey, outcome: Outcome[StepResult]) -> None:
            console.print(f"[green]✓[/green] {key!s:<26} {outcome.summary}", highlight=False)

        @contextlib.contextmanager
        def asking() -> Iterator[None]:
            bar.stop()  # the live line would write over the question
            try:
                yield
            finally:
                bar.start()

        def safe_point() -> None:
            if pause.wanted:
                with asking():
                    pause.safe_point()

        yield Watcher(progress, listener, lambda text: progress(0.0, text), safe_point, asking)


def _write_line(key: StepKey, outcome: Outcome[StepResult]) -> None:
    sys.stderr.write(f"{key}: {outcome.summary}\n")


def _what_is_shown(outcome: dict[str, Any]) -> str:
    known = outcome["mean_application_error_mm"] is not None
    return "error of the needle tip against truth" if known else "predicted error of the needle tip"


def show_outcome(outcome: dict[str, Any], *, as_json: bool) -> None:
    """Print the table of target errors, or the whole object as JSON."""
    if as_json:
        print_json(outcome)
        return
    print_table(
        f"Run {outcome['run']}: {_what_is_shown(outcome)}",
        ("target", "depth mm", "predicted mm", "error mm"),
        [
            (
                row["id"],
                f"{row['depth_mm']:.1f}",
                f"{row['predicted_tre_mm']:.3f}",
                "-" if row["application_error_mm"] is None else f"{row['application_error_mm']:.3f}",
            )
            for row in outcome["targets"]
        ],
    )
    lines = []
    if outcome["mean_application_error_mm"] is not None:
        lines.append(
            f"mean {outcome['mean_application_error_mm']:.3f} mm, "
            f"largest {outcome['max_application_error_mm']:.3f} mm; "
            f"{outcome['sim_s']:.0f} s of theatre time in {outcome['wall_s']:.0f} s"
        )
    if outcome["report"] is not None:
        lines.append(f"report {outcome['report']}")
    sys.stdout.write("\n".join(lines) + "\n")


def follow_case(request: CaseRequest, *, as_json: bool, verbose: bool) -> None:
    """Run a case and show it; with JSON one object also for a run that did not end."""
    check_request(request)
    folder = new_run_folder(request)
    try:
        with following(quiet=as_json, verbose=verbose) as watcher:
            outcome = run_case(request, folder, watcher)
    except BaseException as problem:
        forget_if_empty(folder)
        if as_json:
            ended = "interrupted" if isinstance(problem, KeyboardInterrupt) else "failed"
            print_json(unfinished(request, folder, ended, problem))
        raise
    outcome["report"] = None
    try:
        from procedures.reporting.report import write_report

        outcome["report"] = str(write_report(folder, outcome))
    finally:  # the errors at the targets are known, whatever became of the report
        show_outcome(outcome, as_json=as_json)
