"""Opens the engine of a procedure: its theatre, started or configured, and who answers and acts there."""

from __future__ import annotations

import contextlib
import importlib
import shlex
import shutil
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.alarms import Alarms
from procedures.cli.case.asking import Asking, undisturbed
from procedures.cli.case.case_inputs import case_folder, clinical_input, order_of_case, recorded_order
from procedures.cli.case.leaving_report import begin_report
from procedures.cli.case.operators import SimulatedRoom, TerminalRoom
from procedures.cli.case.request import CaseRequest, TheatreRequest
from procedures.cli.case.request_file import REQUEST_FILE
from procedures.cli.case.simulated_case import SimulatedCase
from procedures.cli.case.who_answers import operator_of
from procedures.composition.procedure import Procedure, Resumption
from ronna_hw.bounded_input import LARGEST_TOML_BYTES, read_bounded
from ronna_hw.command_line.messages import on_terminal, tell
from ronna_hw.errors import RonnaError
from ronna_hw.host.files import require_open_files
from ronna_hw.host.process import ENDING_SIGNALS, interruption_deferred
from ronna_hw.log_output import keep_log

if TYPE_CHECKING:
    from procedures.cli.case.answers import Answers
    from procedures.cli.case.prompt import Prompt
    from procedures.cli.console.pilot import Pilot
    from procedures.engine.engine import Engine
    from procedures.operator.question import Operator
    from procedures.operator.room import Room
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
        alarms = Alarms()
        operator = operator_of(request, watcher, answers, resumption, alarms)
        if watcher.pilot is not None:
            # The same terminal as in `operator_of`.
            at_terminal = on_terminal(sys.stdin) and (watcher.at_pause is not None or on_terminal(sys.stderr))
            operator = watcher.pilot.operator(operator, script_at_pause=not at_terminal)
        away, simulated = None, None
        if file is not None:
            leaving = resumption is not None and resumption.only_leaving
            last = stack.enter_context(held_theatre(file, folder, only_leaving=leaving))
            away = left_away(last, folder)
            simulates = is_simulated(read_theatre_file(file))
            room: Room = TerminalRoom(watcher.asking, simulated=simulates, alarms=alarms)
            if watcher.pilot is not None:
                from procedures.cli.console.room import ConsoleRoom

                room = ConsoleRoom(room, watcher.pilot)
        else:
            simulated = stack.enter_context(
                SimulatedCase(
                    request,
                    folder / "theatre",
                    phantom,
                    goes_on=goes_on,
                    on_controller_message=watcher.room_open,
                )
            )
            for module in ("procedures.steps.catalogue", "procedures.composition.made_engine"):
                importlib.import_module(module)  # a second of imports, meanwhile
            if phantom is not None:
                watcher.status("making the phantom CT")
                simulated.await_patient()
            watcher.status("opening the theatre")
            simulated.await_theatre()
            file = simulated.theatre.file
            watcher.room_open(f"control port {simulated.theatre.control}")
            room = SimulatedRoom(simulated.theatre.control)
        from procedures.composition.made_engine import People, made_engine

        engine = made_engine(
            folder,
            file,
            procedure,
            People(operator, room),
            stack,
            resumption,
            on_ending=ignore_further_signals,
            opening={**request_hash(folder), "seed": request.seed},
            left_away=away,
        )
        if simulated is not None:
            simulated.taken_up()
        alarms.attach(engine)
        outcome, ended_by = "failed", None
        try:
            begin_report(folder)
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
            with watch:
                yield engine
            only_acknowledged = resumption is not None and not resumption.asks
            outcome = "left" if only_acknowledged or not engine.over else "done"
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
    from procedures.planning.plan_lock import lock_plan
    from procedures.planning.tool_records import ToolRecords
    from ronna_hw.records import write_whole

    case = case_folder(request, folder)
    held = contextlib.ExitStack()

    def procedure(theatre: Theatre) -> Procedure:
        if resumption is not None and resumption.only_leaving:
            order = recorded_order(request, resumption.left)
            return Procedure(order, clinical=clinical_input(request, folder))
        if resumption is None:  # before anybody is asked anything; set_up looks again
            now = this_second()
            require_valid(theatre.calibrations, now, _theatre_options(request))
            ToolRecords.of(theatre.file).check(theatre.calibrations, now)
        if request.plan is not None and (resumption is None or resumption.left.untouched):
            plan_bytes = read_bounded(request.plan, LARGEST_TOML_BYTES)
            write_whole(case / "plan.toml", plan_bytes)  # instead of the phantom's own
        plan = held.enter_context(lock_plan(case / "plan.toml"))
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
    from procedures.calibration.validity import options_of

    if request.config is not None:
        return options_of(request.config)
    return f"--sim --scene {shlex.quote(request.choice.scene)} --seed {request.choice.seed}"


def request_hash(folder: Path) -> dict[str, str]:
    """Of the request that a run began with, for the first line of its journal."""
    from ronna_hw.evidence.manifest import sha256_of

    path = folder / REQUEST_FILE
    return {"request_sha256": sha256_of(path)} if path.exists() else {}


def ignore_further_signals() -> None:
    """From here on everything ends anyway; a second signal would only tear the ending apart."""
    if threading.current_thread() is threading.main_thread():
        for number in ENDING_SIGNALS:
            signal.signal(number, signal.SIG_IGN)
