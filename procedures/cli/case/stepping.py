"""`ronna-procedure step`: the case by hand, one command per line on standard input."""

from __future__ import annotations

import contextlib
import os
import sys
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.case_view import EventFollower
from procedures.cli.case.commands import COMMANDS
from procedures.cli.case.display import pause_on_interrupt, write_lines
from procedures.cli.case.operators import terminal_observers
from procedures.cli.case.prompt import Prompt
from procedures.runs.finishing import finalize_run
from procedures.runs.folders import held_run, run_folder
from procedures.runs.lifecycle import open_run
from procedures.runs.request import RunRequest
from procedures.runs.request_checks import check_case
from ronna_hw.command_line.messages import say, tell
from ronna_hw.command_line.terminal import on_terminal

if TYPE_CHECKING:
    from procedures.engine.engine import Engine
    from procedures.runs.console_link import ConsoleRequest
    from procedures.runs.order_executor import OrderExecutor

STOP = "stop"
READ_AHEAD = 1000  # lines; beyond them the writer waits
LONGEST_LINE = 4096  # bytes; a command with its words has a tenth
TOO_LONG = f"line-of-more-than-{LONGEST_LINE}-bytes"  # in place of a longer line: no command, and no answer


class PipedLines:
    """Lines of a script, read ahead so that `stop` overtakes the commands before it; nothing else does."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._lines: deque[str] = deque()  # the last is empty at the end of the input
        self._idle = True  # the case waits for a command, or nothing was read yet

    def attach(self, engine: Engine) -> None:
        """Begin to read, with `stop` for this engine."""
        threading.Thread(target=self._read, args=(engine,), name="standard input", daemon=True).start()

    def ready(self, timeout_s: float) -> bool:
        """Whether a line, or the end, can be read within that host time."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._lines), timeout_s)

    def readline(self) -> str:
        """Return the next line; empty at the end, however often it is asked for."""
        with self._changed:
            self._idle = True
            self._changed.wait_for(lambda: bool(self._lines))
            line = self._lines.popleft() if self._lines[0] else ""
            self._idle = False
            self._changed.notify_all()
        return line

    def _read(self, engine: Engine) -> None:
        for line in chain(lines_from(sys.stdin.fileno()), [""]):
            with self._changed:
                self._changed.wait_for(lambda: len(self._lines) < READ_AHEAD)
                overtakes = line.strip() == STOP and not (self._idle and not self._lines)
                if not overtakes:
                    self._lines.append(line)
                    self._changed.notify_all()
            if overtakes:
                engine.checkpoint.pause("a stop was ordered on the standard input")
                engine.setting.workcell.stop()


def lines_from(descriptor: int) -> Iterator[str]:
    """Yield lines of a descriptor.

    Not by `sys.stdin`: a thread that waits in it holds a lock that the end of the program needs.
    """
    line = bytearray()
    while chunk := os.read(descriptor, LONGEST_LINE):
        *ends, rest = chunk.split(b"\n")
        for end in ends:
            yield f"{_text(line + end)}\n"
            line.clear()
        line += rest
        del line[LONGEST_LINE + 1 :]
    if line:
        yield _text(line)


def _text(line: bytearray) -> str:
    return TOO_LONG if len(line) > LONGEST_LINE else line.decode(errors="replace")


def step_through(request: RunRequest, out: Path, console: ConsoleRequest | None = None) -> None:
    """Read commands until `quit` or the end of the input; failures are shown, and the case is held.

    With a console the case is also operated from there, and goes on from there when the input has ended.
    """
    check_case(request)
    with (
        run_folder(request, out) as folder,
        held_run(folder),
        finalize_run(folder),
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
                from procedures.runs.console_link import attached

                link = stack.enter_context(attached(executor, folder, console))
            engine = stack.enter_context(open_run(request, folder, observers))
            followers.append(EventFollower(engine.events, partial(write_lines, say)))
            followers[0].start()
            if piped is not None:
                piped.attach(engine)
            say(f"run {folder.name}; {' | '.join(COMMANDS)} | quit")
            if executor is None:
                prompt.follow(engine)
                return
            executor.attach(engine)
            link.follow(engine.events)
            link.show_looks(engine.setting.workcell)
            prompt.follow(engine)
            if prompt.input_ended:
                executor.run_to_end(engine)


def _executor(request: RunRequest, piped: PipedLines | None) -> OrderExecutor:
    from procedures.runs.operator_station import OperatorStation
    from procedures.runs.order_executor import OrderExecutor

    station = OperatorStation(waits=request.config is not None)
    if piped is None:
        return OrderExecutor(station, runs=False)
    return OrderExecutor(station, runs=False, typed=piped.ready)
