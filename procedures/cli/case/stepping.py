"""`ronna-procedure step`: manual operation of a case, one command per line on standard input."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.commands import continue_hint
from procedures.cli.case.display import pause_on_interrupt, show_outcome
from procedures.cli.case.event_follower import EventFollower
from procedures.cli.case.piped_lines import PipedLines
from procedures.cli.case.plain_display import write_lines
from procedures.cli.case.prompt import Prompt
from procedures.cli.case.staff import terminal_observers
from procedures.engine.errors import CASE_LEFT_WITH_INSTRUMENT
from procedures.runs.case_outcome import build_finished_outcome, wall_time_s
from procedures.runs.finishing import finalize_run
from procedures.runs.folders import hold_run, run_folder
from procedures.runs.lifecycle import ignore_further_signals, open_run
from procedures.runs.orders import COMMANDS
from procedures.runs.request import RunRequest
from procedures.runs.request_checks import check_case
from ronna_hw.command_line.messages import say, tell
from ronna_hw.command_line.terminal import on_terminal
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, read_chain

if TYPE_CHECKING:
    from procedures.engine.engine import Engine
    from procedures.reporting.outcome import FinishedRun
    from procedures.runs.console_link import ConsoleRequest
    from procedures.runs.interrupted_run import InterruptedRun, Resumption
    from procedures.runs.order_executor import OrderExecutor


def step_through(request: RunRequest, out: Path, console: ConsoleRequest | None = None) -> None:
    """Carry out commands until `quit` or the end of input. A failure is shown and the case is held.

    With a console the case is also operated from there, and goes on from there when the input has ended.
    A finished case ends as by `run`, with the errors at its targets. Raises PRO-055 if an instrument is still
    inside at the end.
    """
    check_case(request, out)
    with run_folder(request, out) as folder, hold_run(folder):
        _carry_out_commands(request, folder, console)


def resume_by_step(request: RunRequest, interrupted: InterruptedRun, *, accepted: bool) -> None:
    """Carry out commands for the rest of an interrupted case, once the findings are accepted.

    The run is held meanwhile by the caller. Raises PRO-032 if it is not resumed, and as `step_through`.
    """
    from procedures.runs.interrupted_run import Resumption

    _carry_out_commands(request, interrupted.folder, None, Resumption(interrupted, accepted))


def _carry_out_commands(
    request: RunRequest, folder: Path, console: ConsoleRequest | None, resumption: Resumption | None = None
) -> None:
    outcome: FinishedRun | None = None
    left = None if resumption is None else resumption.interrupted
    with (
        finalize_run(folder, left, name_report=False) as final,
        pause_on_interrupt() as interrupts,
    ):
        followers: list[EventFollower] = []

        def catch_up() -> None:
            for follower in followers:
                follower.catch_up()

        piped = None if on_terminal(sys.stdin) else PipedLines()
        executor = None if console is None else _executor(request, piped)
        prompt = Prompt(
            "step> ",
            say,
            asking=interrupts.asking,
            after=catch_up,
            meanwhile=None if executor is None else executor.follow_until_typed,
            piped=piped,
        )
        observers = replace(
            terminal_observers(interrupts.asking, interrupts.attach),
            announce=tell,
            at_pause=prompt,
            executor=executor,
        )
        with contextlib.ExitStack() as stack:
            if executor is not None and console is not None:
                from procedures.runs.console_link import ConsoleLink

                link = ConsoleLink(folder, executor.station, console)
                stack.enter_context(contextlib.closing(link))
            engine = stack.enter_context(open_run(request, folder, observers, resumption))
            followers.append(EventFollower(engine.events, partial(write_lines, say)))
            if piped is not None:
                piped.attach(engine)
            if resumption is not None:
                _recover(engine, resumption)
            say(f"run {folder.name}; {' | '.join(COMMANDS)}")
            with _let_finished_case_end(engine):
                if executor is None:
                    prompt.follow(engine)
                else:
                    executor.attach(engine)
                    link.show(engine)
                    prompt.follow(engine)
                    if prompt.input_ended:
                        executor.run_to_end(engine)
            theatre_s = engine.setting.clock.now_s()  # the clock ends with its theatre
        _require_instrument_out(engine)
        if engine.over:
            wall_s = wall_time_s(read_chain(folder / JOURNAL_FILE).lines)
            outcome = build_finished_outcome(
                request, engine.case, engine.order.trajectories, theatre_s, wall_s
            )
    if outcome is not None:
        show_outcome(outcome.model_copy(update={"report": final.report and str(final.report)}), as_json=False)
    elif final.report is not None and on_terminal(sys.stderr):
        tell(f"report {final.report}")


def _recover(engine: Engine, resumption: Resumption) -> None:
    """Compare the theatre with the record, and say how the case goes on once that is accepted."""
    if not resumption.interrupted.untouched:
        from procedures.runs.recovery import recover

        recover(engine, resumption.interrupted)
    hint = continue_hint(
        engine, f"next runs {engine.upcoming}, to {engine.order.sequence[-1]} runs all that is left"
    )
    say(f"this run was begun by step, and goes on by commands: {hint}")


def _require_instrument_out(engine: Engine) -> None:
    """Raise PRO-055 if the case ends with an instrument inside: `quit` is refused, but not the end."""
    inside = engine.setting.workcell.instrument_description
    if inside is None:
        return
    run = shlex.quote(str(engine.case.folder))
    raise CASE_LEFT_WITH_INSTRUMENT(
        f"the commands have ended, and {inside}",
        expected="`home`, which asks whether it is out, before the end",
        action=f"Touch neither the tool nor the arm. ronna-procedure home {run} asks for the removal, then "
        f"brings {engine.setting.workcell.phrases.arms} home; ronna-procedure resume {run} does so and "
        "continues the case.",
    )


@contextlib.contextmanager
def _let_finished_case_end(engine: Engine) -> Iterator[None]:
    """Let a signal at the prompt end a case of which nothing is left as `quit` does, not interrupt it."""
    try:
        yield
    except KeyboardInterrupt:
        if not engine.over:
            raise
        ignore_further_signals()


def _executor(request: RunRequest, piped: PipedLines | None) -> OrderExecutor:
    from procedures.runs.operator_station import OperatorStation
    from procedures.runs.order_executor import OrderExecutor

    station = OperatorStation(waits=request.has_person)
    if piped is None:
        return OrderExecutor(station, runs=False)
    return OrderExecutor(station, runs=False, input_ready=piped.wait_for_line)
