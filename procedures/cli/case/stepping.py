"""`ronna-procedure step`: the case by hand, one command per line on standard input."""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Sequence
from typing import TYPE_CHECKING

from procedures.cli.case.case_view import done_or_note
from procedures.cli.case.commands import COMMANDS
from procedures.cli.case.event_follower import EventFollower
from procedures.cli.case.leaving_report import leaving_report
from procedures.cli.case.opening import Watcher, opened_case
from procedures.cli.case.pause import pause_on_interrupt
from procedures.cli.case.piped_lines import PipedLines
from procedures.cli.case.prompt import Prompt
from procedures.cli.case.request import CaseRequest, check_request, run_folder
from procedures.engine.events import Event
from procedures.engine.run_lock import held_run
from ronna_hw.command_line.messages import say, tell
from ronna_hw.command_line.terminal import on_terminal

if TYPE_CHECKING:
    from procedures.cli.console.attaching import ConsoleRequest
    from procedures.cli.console.pilot import Pilot


def step_through(request: CaseRequest, console: ConsoleRequest | None = None) -> None:
    """Read commands until `quit` or the end of the input; what goes wrong is shown, and the case is held.

    With a console the case is also operated from there, and goes on from there when the input has ended.
    """
    check_request(request)
    with (
        run_folder(request) as folder,
        held_run(folder),
        leaving_report(folder),
        pause_on_interrupt() as interrupts,
    ):
        followers: list[EventFollower] = []

        def catch_up() -> None:
            for follower in followers:
                follower.catch_up()

        piped = None if on_terminal(sys.stdin) else PipedLines()
        pilot = None if console is None else _pilot(request, piped)
        prompt = Prompt(
            "step> ",
            say,
            asking=interrupts.asking,
            after=catch_up,
            meanwhile=None if pilot is None else pilot.follow_until_typed,
            piped=piped,
        )
        watcher = Watcher(
            room_open=tell, opened=interrupts.attach, asking=interrupts.asking, at_pause=prompt, pilot=pilot
        )
        with contextlib.ExitStack() as stack:
            if pilot is not None and console is not None:
                from procedures.cli.console.attaching import attached

                link = stack.enter_context(attached(pilot, folder, console))
            engine = stack.enter_context(opened_case(request, folder, watcher))
            followers.append(EventFollower(engine.events, _say_lines))
            followers[0].start()
            if piped is not None:
                piped.attach(engine)
            say(f"run {folder.name}; {' | '.join(COMMANDS)} | quit")
            if pilot is None:
                prompt.follow(engine)
                return
            pilot.attach(engine)
            link.follow(engine.events)
            link.show_looks(engine.setting.workcell)
            prompt.follow(engine)
            if prompt.input_ended:
                pilot.run_to_end(engine)


def _pilot(request: CaseRequest, piped: PipedLines | None) -> Pilot:
    from procedures.cli.console.desk import Desk
    from procedures.cli.console.pilot import Pilot

    desk = Desk(waits=request.config is not None)
    return Pilot(desk, runs=False) if piped is None else Pilot(desk, runs=False, typed=piped.ready)


def _say_lines(events: Sequence[Event]) -> None:
    for event in events:
        if (line := done_or_note(event)) is not None:
            say(line)
