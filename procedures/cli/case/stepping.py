"""`ronna-procedure step`: the case by hand, one command per line on standard input."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from procedures.cli.case.event_follower import EventFollower
from procedures.cli.case.leaving_report import leaving_report
from procedures.cli.case.opening import Watcher, opened_case
from procedures.cli.case.pause import pause_on_interrupt
from procedures.cli.case.request import CaseRequest, check_request, new_run_folder
from procedures.engine.events import Event, StepState
from ronna_hw.command_line.console import fail_with, on_terminal
from ronna_hw.errors import RonnaError

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

HELP = "list | next | run STEP | to STEP | why [STEP] | home | acknowledge NAME | help | quit"
PROMPT = "step> "


def step_through(request: CaseRequest) -> None:
    """Read commands until `quit` or the end of the input; what goes wrong is shown, and the case is held."""
    check_request(request)
    folder = new_run_folder(request)
    with (
        leaving_report(folder),
        pause_on_interrupt() as interrupts,
        opened_case(request, folder, Watcher(opened=interrupts.attach, asking=interrupts.asking)) as engine,
    ):
        follower = EventFollower(engine.events, _tell_done)
        follower.start()
        _say(f"run {folder.name}; {HELP}")
        while (line := _ask()) is not None:
            name, _, argument = line.strip().partition(" ")
            if name in ("quit", "q"):
                if engine.instrument_in is None:
                    return
                _say(f"the instrument is in {engine.instrument_in}: home brings it out along its axis")
                continue
            command = COMMANDS.get(name)
            if command is None:
                _say(HELP)
                continue
            try:
                command(engine, argument.strip())
            except RonnaError as error:
                if engine.machine.ended:
                    raise
                fail_with(error)
            follower.catch_up()


def _list(engine: Engine, _argument: str) -> None:
    width = max(len(engine.status(key)) for key in engine.order.sequence)
    for key in engine.order.sequence:
        _say(f"{engine.status(key):<{width}}  {key!s:<24} {engine.order.spec(key).title}")


def _next(engine: Engine, _argument: str) -> None:
    if engine.upcoming is None:
        _say("the case is finished")
        return
    engine.run_step(engine.upcoming)


def _run(engine: Engine, argument: str) -> None:
    engine.run_step(engine.order.find(argument))


def _to(engine: Engine, argument: str) -> None:
    key = engine.order.find(argument)
    if engine.case.stands(key):
        _say(f"{key} is done already")
        return
    engine.run_to(key)


def _why(engine: Engine, argument: str) -> None:
    key = engine.order.find(argument) if argument else engine.upcoming
    if key is None:
        _say("the case is finished")
        return
    unmet = engine.why_refused(key)
    _say(f"{key}: " + ("may begin" if not unmet else "refused: " + "; ".join(unmet)))


def _home(engine: Engine, _argument: str) -> None:
    engine.retreat_home()
    _say("the arm is parked")


def _acknowledge(engine: Engine, argument: str) -> None:
    acknowledged = engine.acknowledge(argument)
    _say("; ".join(f"{role}: {fault}" for role, fault in acknowledged.items()) or "no device is in fault")


def _help(_engine: Engine, _argument: str) -> None:
    _say(HELP)


COMMANDS: dict[str, Callable[[Engine, str], None]] = {
    "list": _list,
    "next": _next,
    "run": _run,
    "to": _to,
    "why": _why,
    "home": _home,
    "acknowledge": _acknowledge,
    "help": _help,
    "": _help,
}


def _tell_done(events: Sequence[Event]) -> None:
    for event in events:
        if isinstance(event.what, StepState) and event.what.state == "done":
            _say(f"done {event.what.step}: {event.what.summary}")


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def _ask() -> str | None:
    if on_terminal(sys.stdin):
        sys.stdout.write(PROMPT)
        sys.stdout.flush()
    line = sys.stdin.readline()
    return line if line else None
