"""Opens the engine of a procedure: its theatre, started or configured, and who answers and acts there."""

from __future__ import annotations

import contextlib
import importlib
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.operators import (
    AtPause,
    ScriptedOperator,
    SimulatedRoom,
    TerminalOperator,
    TerminalRoom,
)
from procedures.cli.case.request import CaseRequest, TheatreRequest
from procedures.cli.case.simulated_case import SimulatedCase
from ronna_hw.command_line.console import on_terminal
from ronna_hw.command_line.messages import tell
from ronna_hw.host.interruption import interruption_deferred
from ronna_hw.log_output import keep_log

if TYPE_CHECKING:
    from procedures.cli.case.answers import Answers
    from procedures.cli.case.prompt import Prompt
    from procedures.engine.context import ClinicalInput
    from procedures.engine.engine import Engine
    from procedures.engine.operator import Operator, Room
    from procedures.engine.order import CaseOrder
    from ronna_hw.clock import Clock
    from ronna_hw.config import Calibrations, DeviceConfig
    from ronna_hw.devices.lifecycle import Device
    from ronna_hw.theatre import Theatre


@dataclass(frozen=True)
class Watcher:
    """Who follows a run while it runs."""

    status: Callable[[str], None] = lambda _text: None
    opened: Callable[[Engine], None] = lambda _engine: None  # before its first step
    asking: Callable[[], AbstractContextManager[None]] = contextlib.nullcontext  # around a question
    held: Prompt | None = None  # where a person says how a case goes on that is held; without one it ends
    at_pause: Operator | None = None  # who answers a pause, if another than who answers the rest


@dataclass(frozen=True)
class Procedure:
    """What the engine is to run. `calibrations` take the place of those of the theatre file."""

    order: CaseOrder
    clinical: ClinicalInput | None = None
    calibrations: Calibrations | None = None


@contextlib.contextmanager
def opened_engine(
    request: TheatreRequest,
    folder: Path,
    procedure: Callable[[Theatre], Procedure],
    watcher: Watcher,
    *,
    phantom: Path | None = None,
    answers: Answers | None = None,
) -> Iterator[Engine]:
    """The engine of a procedure, ready to run its first step. Whatever happens, everything ends with it.

    `procedure` is called with the theatre, before its devices are connected; a simulated patient is made in
    the folder `phantom`.
    """
    from procedures.engine.device_watch import DeviceWatch

    with contextlib.ExitStack() as stack:
        stack.enter_context(keep_log(folder, run=folder.name, seed=request.seed))
        file = request.config
        operator = operator_of(request, watcher, answers)
        room: Room = TerminalRoom(watcher.asking)
        if file is None:
            simulated = stack.enter_context(SimulatedCase(request, folder / "theatre", phantom))
            importlib.import_module("procedures.steps.catalogue")  # a second of imports, meanwhile
            if phantom is not None:
                watcher.status("making the phantom CT")
                simulated.await_patient()
            watcher.status("opening the theatre")
            simulated.await_theatre()
            file = simulated.theatre.file
            room = stack.enter_context(contextlib.closing(SimulatedRoom(simulated.theatre.control)))
        engine = _make_engine(request, folder, file, procedure, operator, room, stack)
        outcome = "failed"
        watcher.opened(engine)
        try:
            with DeviceWatch(engine.setting.workcell.devices, engine.events, engine.setting.clock.now_s):
                yield engine
            outcome = "done" if engine.upcoming is None else "left"
        except BaseException as problem:
            ignore_further_signals()
            if isinstance(problem, KeyboardInterrupt):
                outcome = "interrupted"
            raise
        finally:
            if engine.instrument_in is not None:
                tell(f"the instrument is still in {engine.instrument_in}: the arm rests and will not move it")
            with interruption_deferred():
                engine.close(outcome)


def opened_case(request: CaseRequest, folder: Path, watcher: Watcher) -> AbstractContextManager[Engine]:
    """The engine of a clinical case, as `opened_engine`."""
    case = request.case or folder / "case"

    def procedure(_theatre: Theatre) -> Procedure:
        from procedures.engine.context import ClinicalInput
        from procedures.engine.order import order_of
        from procedures.planning.plan_file import read_plan
        from procedures.steps.catalogue import CLINICAL_STEPS
        from procedures.strategies.catalogue import strategy_named

        strategy = strategy_named(request.strategy)
        trajectories = [trajectory.id for trajectory in read_plan(case / "plan.toml").trajectories]
        if request.answers is not None:
            request.answers.check_trajectories(trajectories)
        order = order_of(
            CLINICAL_STEPS,
            trajectories,
            localizes_per_trajectory=strategy.localizes_per_trajectory,
        )
        return Procedure(order, ClinicalInput(case / "ct", case / "plan.toml", strategy))

    return opened_engine(request, folder, procedure, watcher, phantom=case, answers=request.answers)


def operator_of(request: TheatreRequest, watcher: Watcher, answers: Answers | None) -> Operator:
    """Who answers: the file of answers, then the script of a simulated case or the person at the terminal."""
    person: Operator = TerminalOperator(watcher.asking)
    at_terminal = on_terminal(sys.stdin) and on_terminal(sys.stderr)
    at_pause = watcher.at_pause or (person if at_terminal else None)
    operator: Operator = ScriptedOperator(at_pause)
    if request.config is not None:
        operator = person if watcher.at_pause is None else AtPause(watcher.at_pause, person)
    if answers is None:
        return operator
    from procedures.cli.case.answers import AnsweringOperator

    return AnsweringOperator(answers, operator)


def ignore_further_signals() -> None:
    """From here on everything ends anyway; a second signal would only tear the ending apart."""
    if threading.current_thread() is threading.main_thread():
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, signal.SIG_IGN)


def _make_engine(
    request: TheatreRequest,
    folder: Path,
    file: Path,
    procedure: Callable[[Theatre], Procedure],
    operator: Operator,
    room: Room,
    stack: contextlib.ExitStack,
) -> Engine:
    from procedures.engine.case import Case
    from procedures.engine.context import CaseSetting
    from procedures.engine.engine import Engine
    from procedures.engine.events import EventStream
    from procedures.engine.events.event_file import EventFile
    from procedures.engine.journal import Entry, Journal
    from procedures.engine.replay.sections import opening_line, section_follower
    from procedures.guards import standing_guards
    from procedures.workcell import Workcell
    from ronna_hw.recording.byte_lines import BYTES_FOLDER
    from ronna_hw.recording.flight_recorder import FlightRecorder
    from ronna_hw.recording.reading_tape import READINGS_FOLDER, ReadingTape
    from ronna_hw.recording.taped_device import taped
    from ronna_hw.registry import make_device
    from ronna_hw.theatre import Theatre

    def make(name: str, config: DeviceConfig, clock: Clock) -> Device:
        return taped(make_device(name, config, clock), tape)

    theatre = Theatre.from_file(file, make)
    wanted = procedure(theatre)
    calibrations = wanted.calibrations or theatre.calibrations  # what is missing is known before the journal
    events = EventStream(theatre.clock.now_s)
    stack.callback(EventFile(folder, events).join)
    stack.callback(events.end)
    opening = opening_line(folder, file, theatre.clock, wanted.clinical)
    tape = ReadingTape(folder / READINGS_FOLDER, theatre.clock.now_s, opening)
    stack.callback(tape.close)
    follow = section_follower(tape)

    def written(line: bytes) -> None:
        follow(line)
        events.journal_line(line)

    journal = Journal(folder, written)
    flight_recorder = FlightRecorder(folder / BYTES_FOLDER, theatre.clock.now_s)
    stack.callback(flight_recorder.close)
    theatre.record_bytes(flight_recorder)
    workcell = Workcell(theatre, journal, calibrations=calibrations)
    journal.write(
        Entry.OPENED,
        theatre.clock.now_s(),
        theatre=theatre.file.theatre,
        banner=theatre.file.banner,
        strategy=None if wanted.clinical is None else wanted.clinical.strategy.name,
        seed=request.seed,
    )
    engine = Engine(
        wanted.order,
        Case(folder),
        CaseSetting(
            workcell=workcell,
            clock=theatre.clock,
            operator=operator,
            room=room,
            settings=theatre.file.procedure,
            surroundings=theatre.file.cell,
            clinical=wanted.clinical,
        ),
        journal,
        events=events,
        on_ending=ignore_further_signals,
        recorders=(flight_recorder, tape),
    )
    engine.checkpoint.beside = tape.beside
    engine.checkpoint.guards.extend(standing_guards(workcell, folder, theatre.clock, engine.find))
    return engine
