"""Opens the engine of a procedure: its theatre, started or configured, and who answers and acts there."""

from __future__ import annotations

import contextlib
import importlib
import shlex
import shutil
import signal
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.asking import Asking, undisturbed
from procedures.cli.case.case_inputs import case_folder, clinical_input, order_of_case, recorded_order
from procedures.cli.case.operators import (
    SimulatedRoom,
    TerminalRoom,
)
from procedures.cli.case.request import CaseRequest, TheatreRequest
from procedures.cli.case.request_file import REQUEST_FILE
from procedures.cli.case.simulated_case import SimulatedCase
from procedures.cli.case.who_answers import operator_of
from ronna_hw.command_line.messages import tell
from ronna_hw.errors import RonnaError
from ronna_hw.host.interruption import interruption_deferred
from ronna_hw.host.open_files import require_open_files
from ronna_hw.log_output import keep_log

if TYPE_CHECKING:
    from procedures.cli.case.answers import Answers
    from procedures.cli.case.prompt import Prompt
    from procedures.cli.console.pilot import Pilot
    from procedures.engine.context import ClinicalInput
    from procedures.engine.engine import Engine
    from procedures.engine.left_run import LeftRun
    from procedures.engine.order import CaseOrder
    from procedures.operator.question import Operator
    from procedures.operator.room import Room
    from procedures.steps.calibration.recipe import Recipe
    from ronna_hw.clock import Clock
    from ronna_hw.config import Calibrations, DeviceConfig
    from ronna_hw.devices.lifecycle import Device
    from ronna_hw.theatre import Theatre

OPEN_FILES = 96  # a case was measured to have 41 open at once; the rest is room for plots and libraries


@dataclass(frozen=True)
class Watcher:
    """Who follows a run while it runs."""

    status: Callable[[str], None] = lambda _text: None
    room_open: Callable[[str], None] = lambda _text: None  # a simulated theatre's control port and pendant
    opened: Callable[[Engine], None] = lambda _engine: None  # before its first step
    asking: Asking = undisturbed  # around a question
    held: Prompt | None = None  # where a person says how a case goes on that is held; without one it ends
    at_pause: Operator | None = None  # who answers a pause, if another than who answers the rest
    pilot: Pilot | None = None  # of a console that operates the case


@dataclass(frozen=True)
class Resumption:
    """A run that is taken up again; `accepted` where a script accepts what is found.

    With `only_leaving` no step is run: the arm goes home, or devices are acknowledged, which `asks` nothing.
    """

    left: LeftRun
    accepted: bool
    only_leaving: bool = False
    asks: bool = True


@dataclass(frozen=True)
class Procedure:
    """What the engine is to run. `calibrations` take the place of those of the theatre file.

    `recipe` is what a replay of a calibration makes its steps from.
    """

    order: CaseOrder
    title: str | None = None  # of what is no clinical case
    clinical: ClinicalInput | None = None
    calibrations: Calibrations | None = None
    recipe: Recipe | None = None

    def as_plain(self, in_use: Calibrations) -> dict[str, object] | None:
        """The recipe and the records in use, for whoever computes this again."""
        if self.recipe is None:
            return None
        records = in_use.model_dump(mode="json", exclude_none=True)
        return {"recipe": self.recipe.model_dump(mode="json"), "records": records}


@contextlib.contextmanager
def opened_engine(
    request: TheatreRequest,
    folder: Path,
    procedure: Callable[[Theatre], Procedure],
    watcher: Watcher,
    *,
    phantom: Path | None = None,
    answers: Answers | None = None,
    resumption: Resumption | None = None,
) -> Iterator[Engine]:
    """The engine of a procedure, ready to run its first step. Whatever happens, everything ends with it.

    `procedure` is called with the theatre, before its devices are connected; a simulated patient is made in
    the folder `phantom`. With `resumption` the folder is that of a run that is taken up again.
    """
    from procedures.cli.case.left_away import left_away
    from procedures.engine.body_view import BodyView
    from procedures.engine.device_watch import PERIOD_S, SEEN_MOVING_S, DeviceWatch
    from procedures.engine.outlook import publish_order
    from procedures.engine.theatre_lock import held_theatre
    from ronna_hw.config import read_theatre_file
    from ronna_hw.theatre_kind import is_simulated

    require_open_files(OPEN_FILES)
    goes_on = resumption is not None and not resumption.left.untouched
    with contextlib.ExitStack() as stack:
        stack.enter_context(keep_log(folder, run=folder.name, seed=request.seed))
        file = request.config
        operator = operator_of(request, watcher, answers, resumption)
        if watcher.pilot is not None:
            operator = watcher.pilot.operator(operator)
        away = None
        if file is not None:
            away = left_away(stack.enter_context(held_theatre(file, folder)))
            room: Room = TerminalRoom(watcher.asking, simulated=is_simulated(read_theatre_file(file)))
            if watcher.pilot is not None:
                from procedures.cli.console.room import ConsoleRoom

                room = ConsoleRoom(room, watcher.pilot)
        else:
            simulated = stack.enter_context(
                SimulatedCase(
                    request, folder / "theatre", phantom, goes_on=goes_on, pendant=watcher.room_open
                )
            )
            importlib.import_module("procedures.steps.catalogue")  # a second of imports, meanwhile
            if phantom is not None:
                watcher.status("making the phantom CT")
                simulated.await_patient()
            watcher.status("opening the theatre")
            simulated.await_theatre()
            file = simulated.theatre.file
            watcher.room_open(f"control port {simulated.theatre.control}")
            room = SimulatedRoom(simulated.theatre.control)
        engine = _make_engine(
            request, folder, file, procedure, operator, room, stack, resumption, left_away=away
        )
        outcome, ended_by = "failed", None
        publish_order(engine)
        watcher.opened(engine)
        workcell = engine.setting.workcell
        watch = DeviceWatch(
            workcell.devices,
            engine.events,
            engine.setting.clock.now_s,
            PERIOD_S if watcher.pilot is None else SEEN_MOVING_S,
            BodyView(workcell),
        )
        try:
            with watch:
                yield engine
            outcome = "done" if engine.over else "left"
        except BaseException as problem:  # also an interruption: nothing may cut the way to rest short
            ignore_further_signals()
            if isinstance(problem, KeyboardInterrupt):
                outcome = "interrupted"
            ended_by = problem if isinstance(problem, RonnaError) else None
            raise
        finally:
            if engine.instrument_in is not None:
                tell(f"an instrument is still in {engine.instrument_in}: the arm does not move")
            with interruption_deferred():
                engine.close(outcome, ended_by)


@contextlib.contextmanager
def opened_case(
    request: CaseRequest, folder: Path, watcher: Watcher, resumption: Resumption | None = None
) -> Iterator[Engine]:
    """The engine of a clinical case, as `opened_engine`. Its plan is held meanwhile."""
    from procedures.calibration.validity import require_valid
    from procedures.engine.context import this_second
    from procedures.planning.plan.lock import held_plan
    from ronna_hw.records import write_whole

    case = case_folder(request, folder)
    held = contextlib.ExitStack()

    def procedure(theatre: Theatre) -> Procedure:
        if resumption is not None and resumption.only_leaving:
            order = recorded_order(request, resumption.left)
            return Procedure(order, clinical=clinical_input(request, folder))
        if resumption is None:  # before anybody is asked anything; set_up looks again
            require_valid(theatre.calibrations, this_second(), _theatre_options(request))
        if request.plan is not None and (resumption is None or resumption.left.untouched):
            write_whole(case / "plan.toml", request.plan.read_bytes())  # instead of the phantom's own
        plan = held.enter_context(held_plan(case / "plan.toml"))
        order = order_of_case(request, folder, plan)
        if request.answers is not None:
            request.answers.check_trajectories(order.trajectories)
        return Procedure(order, clinical=clinical_input(request, folder, plan))

    complete = request.case is None and (case / "plan.toml").exists()  # the phantom's last file
    if resumption is not None and request.case is None and not complete:
        shutil.rmtree(case, ignore_errors=True)  # half of a simulated patient
    with (
        held,
        opened_engine(
            request,
            folder,
            procedure,
            watcher,
            phantom=None if complete else case,
            answers=request.answers,
            resumption=resumption,
        ) as engine,
    ):
        yield engine


def _theatre_options(request: TheatreRequest) -> str:
    """How a calibration is given the same theatre, and its records to it."""
    if request.config is not None:
        file = shlex.quote(str(request.config))
        return f"--config {file} --write {file}"
    return f"--sim --scene {shlex.quote(request.choice.scene)} --seed {request.choice.seed}"


def request_hash(folder: Path) -> dict[str, str]:
    """Of the request that a run began with, for the first line of its journal."""
    from ronna_hw.evidence.seal import sha256_of

    path = folder / REQUEST_FILE
    return {"request_sha256": sha256_of(path)} if path.exists() else {}


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
    resumption: Resumption | None,
    *,
    left_away: str | None,
) -> Engine:
    from procedures.engine.case import Case
    from procedures.engine.context import CaseSetting, this_second
    from procedures.engine.engine import Engine
    from procedures.engine.events import EventStream
    from procedures.engine.events.event_file import EventFile
    from procedures.engine.replay.sections import opening_line, section_follower
    from procedures.engine.step import StepKey
    from procedures.guards import GuideStill, patient_watch, sight_guard, standing_guards
    from procedures.journal.journal import Entry, Journal, JournalValue
    from procedures.recovery.moved_cart import MovedCart
    from procedures.steps.clinical.global_localization import GlobalLocalization
    from procedures.steps.clinical.validity.inputs import UnchangedInputs
    from procedures.steps.clinical.validity.moved_head import void_moved
    from procedures.workcell import Workcell
    from ronna_hw.evidence.truth_so_far import truth_so_far
    from ronna_hw.recording.byte_lines import BYTES_FOLDER
    from ronna_hw.recording.flight_recorder import FlightRecorder
    from ronna_hw.recording.reading_tape import READINGS_FOLDER, ReadingTape
    from ronna_hw.recording.taped_device import taped
    from ronna_hw.registry import make_device
    from ronna_hw.software import this_software
    from ronna_hw.theatre import Theatre

    def make(name: str, config: DeviceConfig, clock: Clock) -> Device:
        return taped(make_device(name, config, clock), tape)

    theatre = Theatre.from_file(file, make)
    wanted = procedure(theatre)
    calibrations = wanted.calibrations or theatre.calibrations  # what is missing is known before the journal
    events = EventStream(theatre.clock.now_s)
    stack.callback(EventFile(folder, events).join)
    stack.callback(events.end)
    began = this_second()
    opening = opening_line(folder, file, theatre.clock, wanted.clinical, began, wanted.as_plain(calibrations))
    tape = ReadingTape(folder / READINGS_FOLDER, theatre.clock.now_s, opening)
    stack.callback(tape.close)
    follow = section_follower(tape)

    def written(line: bytes) -> None:
        follow(line)
        events.journal_line(line)

    def before_result() -> dict[str, JournalValue]:
        tape.settle()  # what stands can be computed again, also after a kill
        return truth_so_far(folder)

    left = None if resumption is None else resumption.left
    case = Case(folder) if left is None else left.restored(wanted.order)
    if left is None or not left.has_journal:
        journal = Journal(folder, written)
    else:
        journal = Journal.taken_up(folder, left.chain, written)
    flight_recorder = FlightRecorder(folder / BYTES_FOLDER, theatre.clock.now_s)
    stack.callback(flight_recorder.close)
    theatre.record_bytes(flight_recorder)
    workcell = Workcell(
        theatre, journal, calibrations=calibrations, calibrating=wanted.calibrations is not None
    )
    journal.write(
        Entry.RESTARTED if left is not None and left.run.journal else Entry.OPENED,
        theatre.clock.now_s(),
        **({} if left is None else left.as_plain()),
        **request_hash(folder),
        **truth_so_far(folder),
        run=case.run,
        software=str(this_software()),
        theatre=theatre.file.theatre,
        banner=theatre.file.banner,
        procedure=wanted.title,
        strategy=None if wanted.clinical is None else wanted.clinical.strategy.name,
        plan_sha256=None if wanted.clinical is None else wanted.clinical.plan_sha256,
        seed=request.seed,
    )
    engine = Engine(
        wanted.order,
        case,
        CaseSetting(
            workcell=workcell,
            clock=theatre.clock,
            operator=operator,
            room=room,
            settings=theatre.file.procedure,
            surroundings=theatre.file.cell_with_tools,
            clinical=wanted.clinical,
            left_away=left_away if left is None else None,
            began=began,
        ),
        journal,
        events=events,
        on_ending=ignore_further_signals,
        before_result=before_result,
        recorders=(flight_recorder, tape),
        recovering=left is not None and not left.untouched,
        latest=None if left is None else left.latest,
    )
    engine.checkpoint.beside = tape.beside
    engine.checkpoint.guards.extend(standing_guards(workcell, folder, theatre.clock, engine.find))
    if wanted.clinical is not None:
        engine.goes_on = MovedCart(engine).agreed_to_go_on
        if resumption is None or not resumption.only_leaving:
            engine.checkpoint.guards.append(UnchangedInputs(engine, wanted.clinical))
        void = partial(void_moved, engine.context(StepKey(GlobalLocalization.kind)))
        engine.checkpoint.guards.append(sight_guard(engine, void))
        engine.checkpoint.guards.append(GuideStill(workcell, theatre.clock, engine.setting.memory))
        engine.checkpoint.watching = patient_watch(engine, void).watching
    return engine
