"""Display of a running case and its outcome, and Ctrl-C handling.

Ctrl-C on a terminal: once pauses at the next safe point, twice stops the arm, three times ends all. Safe
points are between steps and before each motion. While a question is open here, or the case waits for a person
at the console, nothing moves and the second one ends everything. What a person types or answers in between
makes the next one the first again.
Without a terminal nothing is changed: one signal ends the command.
"""

from __future__ import annotations

import contextlib
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING

from procedures.cli.case.event_follower import EventFollower, Show
from procedures.cli.case.operators import WritePrompt, write_prompt
from procedures.cli.case.plain_display import PlainDisplay, write_lines
from procedures.cli.case.prompt import Prompt
from procedures.cli.case.staff import terminal_observers
from procedures.runs.case_outcome import build_unfinished_outcome, run_case
from procedures.runs.finishing import TAKE_OUT, Finalized, finalize_run
from procedures.runs.folders import hold_run, run_folder
from procedures.runs.observers import RunObservers
from procedures.runs.request import RunRequest
from procedures.runs.request_checks import check_case
from ronna_hw.command_line.terminal import (
    message_console,
    on_terminal,
    print_json,
    print_table,
    say,
    takes_escapes,
    tell,
)
from ronna_hw.errors import RefusedError, RonnaError
from ronna_hw.text import escape_controls

if TYPE_CHECKING:
    from procedures.cli.case.live_display import LiveDisplay
    from procedures.engine.engine import Engine
    from procedures.reporting.outcome import FinishedRun
    from procedures.runs.archive import Archive
    from procedures.runs.console_link import ConsoleRequest
    from procedures.runs.interrupted_run import InterruptedRun
    from procedures.runs.openigtlink import LinkAddress

STANDARD_ERROR = 2
PAUSING = b"\npausing at the next safe point; Ctrl-C again stops the arm now\n"
STOPPING = b"\nstopping the arm; Ctrl-C again ends the command\n"
AT_QUESTION = "the arm rests; Ctrl-C again ends the command"
AT_CONSOLE = b"\nnothing moves, the case waits for a person at the console; Ctrl-C again ends the command\n"
AGAIN_S = 30.0  # host time in which a second Ctrl-C at such a wait is one


class Interrupts:
    """Ctrl-C handler of a running engine."""

    def __init__(self) -> None:
        self._engine: Engine | None = None
        self._count = 0
        self._at_question: int | None = None  # interrupts at the open question, if any
        self._waiting_since_s = -AGAIN_S  # of the last interrupt while a person at the console was awaited
        self._signed_answers = 0  # from the console, at the last interrupt
        self._question = self._prompt = ""

    def attach(self, engine: Engine) -> None:
        """Direct Ctrl-C to this engine. Until then, Ctrl-C ends the command."""
        self._engine = engine

    @contextlib.contextmanager
    def asking(self) -> Iterator[WritePrompt]:
        """During a question, repeat it on the first Ctrl-C and end the command on the second.

        Nothing moves meanwhile. On Ctrl-C a terminal discards output that it has not shown yet.
        """
        self._at_question, self._question, self._prompt = 0, "", ""
        try:
            yield self._write
        finally:
            self._at_question = None
            self._begin_anew()

    def _write(self, prompt: str, *, question: str = "") -> None:
        self._at_question = 0  # something was typed since the last prompt, or a device has come into fault
        self._question, self._prompt = question, prompt
        write_prompt(prompt)

    def _begin_anew(self) -> None:
        self._count, self._waiting_since_s = 0, -AGAIN_S

    def interrupt(self) -> None:
        """Count a Ctrl-C. Raises KeyboardInterrupt if it must end the command."""
        engine = self._engine
        if engine is None or self._at_question:
            if self._at_question:
                os.write(STANDARD_ERROR, b"\n")  # the prompt is still there
            raise KeyboardInterrupt
        if self._at_question is not None:
            self._at_question += 1
            workcell = engine.setting.workcell
            inside = workcell.instrument_description
            also = "" if inside is None else f"; {inside}"
            if inside is not None and workcell.held_instrument is None:  # otherwise an arm leads it out
                also = f"{also}: {TAKE_OUT}"
            os.write(STANDARD_ERROR, f"\n{AT_QUESTION}{also}\n{self._question}{self._prompt}".encode())
            return
        if self._signed_answers != (answers := engine.questions.signed_answers):
            self._signed_answers = answers
            self._begin_anew()
        if engine.is_awaiting_person():
            before_s, self._waiting_since_s = self._waiting_since_s, time.monotonic()
            if self._waiting_since_s - before_s < AGAIN_S:
                raise KeyboardInterrupt
            os.write(STANDARD_ERROR, AT_CONSOLE)
            return
        self._count = self._count + 1 if engine.checkpoint.wanted else 1
        if self._count > 2:
            raise KeyboardInterrupt
        engine.checkpoint.pause("Ctrl-C")
        if self._count == 2:
            threading.Thread(target=engine.setting.workcell.stop, name="stop now").start()
        # This runs inside a signal handler: the buffered streams may be in the middle of a write.
        os.write(STANDARD_ERROR, PAUSING if self._count == 1 else STOPPING)


@contextlib.contextmanager
def pause_on_interrupt() -> Iterator[Interrupts]:
    """Within the block, request a pause on Ctrl-C, provided that the command runs on a terminal."""
    interrupts = Interrupts()
    if not (on_terminal(sys.stdin) and on_terminal(sys.stderr)):
        yield interrupts
        return

    def handle_signal(_number: int, _frame: FrameType | None) -> None:
        interrupts.interrupt()

    before = signal.signal(signal.SIGINT, handle_signal)
    try:
        yield interrupts
    finally:
        signal.signal(signal.SIGINT, before)


@contextlib.contextmanager
def observe_run(*, quiet: bool) -> Iterator[RunObservers]:
    """Show a run as it proceeds: live on a terminal, otherwise one line per step and finding.

    A dumb terminal gets these lines too; its person is asked and pauses the case as on any other.
    """
    with contextlib.ExitStack() as stack:
        if quiet or not on_terminal(sys.stderr):
            opened = (lambda _engine: None) if quiet else partial(_write_lines_of, stack=stack)
            yield replace(terminal_observers(opened=opened), announce=tell)
            return
        display = create_display()
        interrupts = stack.enter_context(pause_on_interrupt())
        stack.enter_context(display.shown())
        followers: list[EventFollower] = []

        def attach_engine(engine: Engine) -> None:
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
        yield replace(
            terminal_observers(asking, attach_engine),
            status=display.status,
            announce=display.tell,
            held=held,
            at_pause=held,
        )


def create_display() -> LiveDisplay | PlainDisplay:
    """Return a live display if the terminal can draw it, else lines."""
    if not takes_escapes(sys.stderr):
        return PlainDisplay(tell)
    from procedures.cli.case.live_display import LiveDisplay

    return LiveDisplay(message_console(), errors=False)


def _follow(engine: Engine, show: Show, stack: contextlib.ExitStack) -> EventFollower:
    follower = EventFollower(engine.events, show)
    stack.callback(follower.join)
    return follower


def _write_lines_of(engine: Engine, stack: contextlib.ExitStack) -> None:
    _follow(engine, partial(write_lines, tell), stack)


def show_outcome(outcome: FinishedRun, *, as_json: bool) -> None:
    """Print the target errors as a table, or the whole outcome as JSON.

    Exits with 3 if a target is in doubt, or its known error is above the margin of the plan.
    """
    if as_json:
        by_target = ("left_out", "in_doubt", "beyond_margin", "limit_beyond_margin")
        empty = {name for name in by_target if not getattr(outcome, name)}
        print_json(outcome.model_dump(mode="json", exclude=empty))
    else:
        _show_table(outcome)
    if outcome.in_doubt or outcome.beyond_margin:
        raise SystemExit(RefusedError.exit_code)


def _show_table(outcome: FinishedRun) -> None:
    from procedures.operator.margin import LIMIT_BEYOND_MARGIN
    from procedures.reporting.run_reading import describe_strategies
    from procedures.strategies.names import SCAN_OF_SKIN

    mean_mm, largest_mm = outcome.mean_application_error_mm, outcome.max_application_error_mm
    known = mean_mm is not None
    rows = []
    for target in outcome.targets:
        error_mm = target.application_error_mm
        error = "-" if error_mm is None else f"{error_mm:.3f}"
        rows.append((target.id, f"{target.depth_mm:.1f}", f"{target.predicted_tre_mm:.3f}", error))
    title = "error of the needle tip against truth" if known else "predicted error of the needle tip"
    print_table(f"Run {outcome.run}: {title}", ("target", "depth mm", "predicted mm", "error mm"), rows)
    strategies = describe_strategies(outcome.strategy, {one.id: one.strategy for one in outcome.targets})
    if strategies == SCAN_OF_SKIN:
        say("registered on the skin")
    elif strategies != outcome.strategy:
        say(f"strategy {strategies}")
    for name, reason in outcome.left_out.items():
        say(f"without {name}: {reason}")
    for reason in dict.fromkeys(one for reasons in outcome.in_doubt.values() for one in reasons):
        say(f"NOT CONFIRMED: {reason}")
    for name, error_mm in outcome.beyond_margin.items():
        say(f"MISSED: the needle was {error_mm:.2f} mm from {name}, more than the margin of the plan accepts")
    for name, limit_mm in outcome.limit_beyond_margin.items():
        say(f"{name}: {LIMIT_BEYOND_MARGIN}, {limit_mm:.3f} mm predicted")
    if known:
        sys.stdout.write(
            f"mean {mean_mm:.3f} mm, largest {largest_mm:.3f} mm; "
            f"{outcome.sim_s:.0f} s of theatre time in {outcome.wall_s:.0f} s\n"
        )
    if outcome.report is not None:
        sys.stdout.write(f"report {escape_controls(str(outcome.report))}\n")


def follow_case(
    request: RunRequest,
    out: Path,
    *,
    as_json: bool,
    console: ConsoleRequest | None = None,
    openigtlink: LinkAddress | None = None,
    archive: Archive | None = None,
) -> None:
    """Run and show a case in a new folder in `out`. With `as_json`, always print exactly one object."""
    check_case(request, out)
    with run_folder(request, out) as folder, hold_run(folder):
        waits = request.has_person

        def run(observers: RunObservers) -> FinishedRun:
            if archive is not None:
                observers = replace(observers, patient=archive.pass_through)
            return run_case(request, folder, observers)

        follow(request, folder, run, console, as_json=as_json, waits=waits, openigtlink=openigtlink)
        if archive is not None:
            try:
                archive.store_results(folder)
            except RonnaError:
                tell(
                    f"the case is done, but its results are not in the archive. To store them later: "
                    f"ronna-procedure export {folder} --identity-from {folder}/case/ct --out DIR, "
                    f"then ronna-dicom send {archive.peer} DIR"
                )
                raise


def follow(
    request: RunRequest,
    folder: Path,
    run: Callable[[RunObservers], FinishedRun],
    console: ConsoleRequest | None,
    *,
    as_json: bool,
    waits: bool,
    left: InterruptedRun | None = None,
    openigtlink: LinkAddress | None = None,
) -> None:
    """Show a case while it runs, write its report, then show its outcome. `left` is the run being resumed.

    With a console that `waits`, nothing is done until someone has taken the operator's seat.
    """
    final = Finalized()
    try:
        with (
            contextlib.ExitStack() as at_last,  # a console shows how the run ended: it closes after the seal
            finalize_run(folder, left, with_truth=False, name_report=False) as final,  # the outcome names it
            observe_run(quiet=as_json) as shown,
        ):
            if console is not None:
                from procedures.runs.console_link import with_console

                shown = at_last.enter_context(with_console(shown, folder, console, waits=waits))
            if openigtlink is not None:
                from procedures.runs.openigtlink import with_openigtlink

                shown = at_last.enter_context(with_openigtlink(shown, folder, openigtlink))
            outcome = run(shown)
    except BaseException as problem:  # also an interruption: a script gets its JSON object whatever happens
        if as_json:
            unfinished_outcome = build_unfinished_outcome(request, folder, problem)
            report = final.report and str(final.report)
            print_json(unfinished_outcome.model_copy(update={"report": report}).model_dump(mode="json"))
        raise
    show_outcome(outcome.model_copy(update={"report": final.report and str(final.report)}), as_json=as_json)
