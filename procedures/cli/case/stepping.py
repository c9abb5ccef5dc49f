"""`ronna-procedure step`: the case by hand, one command per line on standard input."""

from __future__ import annotations

from collections.abc import Sequence

from procedures.cli.case.case_view import done_or_note
from procedures.cli.case.commands import COMMANDS
from procedures.cli.case.event_follower import EventFollower
from procedures.cli.case.leaving_report import leaving_report
from procedures.cli.case.opening import Watcher, opened_case
from procedures.cli.case.pause import pause_on_interrupt
from procedures.cli.case.prompt import Prompt
from procedures.cli.case.request import CaseRequest, check_request, run_folder
from procedures.engine.events import Event
from procedures.engine.run_lock import held_run
from ronna_hw.command_line.messages import say, tell


def step_through(request: CaseRequest) -> None:
    """Read commands until `quit` or the end of the input; what goes wrong is shown, and the case is held."""
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

        prompt = Prompt("step> ", say, asking=interrupts.asking, after=catch_up)
        watcher = Watcher(room_open=tell, opened=interrupts.attach, asking=interrupts.asking, at_pause=prompt)
        with opened_case(request, folder, watcher) as engine:
            followers.append(EventFollower(engine.events, _say_lines))
            followers[0].start()
            say(f"run {folder.name}; {' | '.join(COMMANDS)} | quit")
            prompt.follow(engine)


def _say_lines(events: Sequence[Event]) -> None:
    for event in events:
        if (line := done_or_note(event)) is not None:
            say(line)
