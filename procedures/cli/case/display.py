"""What a person sees while a case runs, and at its end."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.asking import WritePrompt
from procedures.cli.case.case_view import done_or_note
from procedures.cli.case.event_follower import EventFollower, Show
from procedures.cli.case.leaving_report import end_unfinished, leave_report, seal_run
from procedures.cli.case.opening import Watcher
from procedures.cli.case.outcome import run_case, unfinished
from procedures.cli.case.pause import pause_on_interrupt
from procedures.cli.case.prompt import Prompt
from procedures.cli.case.request import CaseRequest, check_request, run_folder
from procedures.engine.events import Event
from procedures.engine.run_lock import held_run
from ronna_hw.command_line.terminal import message_console, on_terminal, print_json, print_table, say, tell
from ronna_hw.errors import RefusedError
from ronna_hw.text import without_controls

if TYPE_CHECKING:
    from procedures.cli.console.attaching import ConsoleRequest
    from procedures.engine.engine import Engine
    from procedures.reporting.outcome import FinishedRun


@contextlib.contextmanager
def following(*, quiet: bool) -> Iterator[Watcher]:
    """Follow a run by its events: live on a terminal, one line per step and finding elsewhere."""
    with contextlib.ExitStack() as stack:
        if quiet or not on_terminal(sys.stderr):
            lines = Watcher(room_open=tell)
            if not quiet:
                lines = replace(lines, opened=lambda engine: _write_lines_of(engine, stack))
            yield lines
            return
        from procedures.cli.case.live_display import LiveDisplay

        display = LiveDisplay(message_console(), errors=False)
        interrupts = stack.enter_context(pause_on_interrupt())
        stack.enter_context(display.shown())
        followers: list[EventFollower] = []

        def opened(engine: Engine) -> None:
            interrupts.attach(engine)
            if held is not None:
                held.attach(engine)
            followers.append(_follow(engine, display.show, stack))

        @contextlib.contextmanager
        def asking() -> Iterator[WritePrompt]:
            with contextlib.ExitStack() as silence:
                for follower in followers:
                    silence.enter_context(follower.quiet())
                silence.enter_context(display.hidden())  # it would write over the question
                yield silence.enter_context(interrupts.asking())

        held = Prompt("held> ", tell, asking=asking, resumes=True) if on_terminal(sys.stdin) else None
        yield Watcher(display.status, display.tell, opened, asking, held, held)


def _follow(engine: Engine, show: Show, stack: contextlib.ExitStack) -> EventFollower:
    follower = EventFollower(engine.events, show)
    stack.callback(follower.join)
    follower.start()
    return follower


def _write_lines_of(engine: Engine, stack: contextlib.ExitStack) -> None:
    _follow(engine, _write_lines, stack)


def _write_lines(events: Sequence[Event]) -> None:
    for event in events:
        if (line := done_or_note(event)) is not None:
            tell(line)


def show_outcome(outcome: FinishedRun, *, as_json: bool) -> None:
    """Print the table of target errors, or the whole object as JSON. Exits with 3 for targets in doubt."""
    if as_json:
        empty = {name for name in ("left_out", "in_doubt") if not getattr(outcome, name)}
        print_json(outcome.model_dump(mode="json", exclude=empty))
    else:
        _show_table(outcome)
    if outcome.in_doubt:
        raise SystemExit(RefusedError.exit_code)


def _show_table(outcome: FinishedRun) -> None:
    mean_mm, largest_mm = outcome.mean_application_error_mm, outcome.max_application_error_mm
    known = mean_mm is not None
    print_table(
        f"Run {outcome.run}: "
        + ("error of the needle tip against truth" if known else "predicted error of the needle tip"),
        ("target", "depth mm", "predicted mm", "error mm"),
        [
            (
                target.id,
                f"{target.depth_mm:.1f}",
                f"{target.predicted_tre_mm:.3f}",
                "-" if target.application_error_mm is None else f"{target.application_error_mm:.3f}",
            )
            for target in outcome.targets
        ],
    )
    for name, reason in outcome.left_out.items():
        say(f"without {name}: {reason}")
    for reason in dict.fromkeys(one for reasons in outcome.in_doubt.values() for one in reasons):
        say(f"NOT CONFIRMED: {reason}")
    if known:
        sys.stdout.write(
            f"mean {mean_mm:.3f} mm, largest {largest_mm:.3f} mm; "
            f"{outcome.sim_s:.0f} s of theatre time in {outcome.wall_s:.0f} s\n"
        )
    if outcome.report is not None:
        sys.stdout.write(f"report {without_controls(str(outcome.report))}\n")


def follow_case(request: CaseRequest, *, as_json: bool, console: ConsoleRequest | None = None) -> None:
    """Run a case and show it; with JSON one object also for a run that did not end."""
    check_request(request)
    with run_folder(request) as folder, held_run(folder):

        def run(watcher: Watcher) -> FinishedRun:
            if console is None:
                return run_case(request, folder, watcher)
            from procedures.cli.console.attaching import with_console

            with with_console(watcher, folder, console, waits=request.config is not None) as operated:
                return run_case(request, folder, operated)

        follow(request, folder, run, as_json=as_json)


def follow(
    request: CaseRequest,
    folder: Path,
    run: Callable[[Watcher], FinishedRun],
    *,
    as_json: bool,
) -> None:
    """Show a run while it runs and what it came to, and leave its report."""
    try:
        with following(quiet=as_json) as watcher:
            outcome = run(watcher)
    except BaseException as problem:  # also an interruption: every run leaves a report
        report = end_unfinished(folder, problem)
        if as_json:
            ended = unfinished(request, folder, problem)
            print_json(ended.model_copy(update={"report": report and str(report)}).model_dump(mode="json"))
        raise
    report = leave_report(folder, name_it=False)  # the outcome names it
    seal_run(folder)
    show_outcome(outcome.model_copy(update={"report": report and str(report)}), as_json=as_json)
