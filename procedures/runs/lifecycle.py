"""Common lifecycle of all runs: open the theatre, run the steps, close everything.

Cases, calibrations and measurements differ only in their steps and conclusions; see `case` and
`calibrations`.
"""

from __future__ import annotations

import contextlib
import importlib
import os
import shutil
import signal
import threading
from collections.abc import Callable, Collection, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.journal.errors import RunDeleted, StepRefused
from procedures.operator.errors import OperatorAborted
from procedures.operator.question import Room
from procedures.runs.finishing import begin_report
from procedures.runs.observers import SEAT_AWAITED, RunObservers, operator_selection
from procedures.runs.request import CalibrationProcedure, CaseProcedure, Measurement, RunRequest
from procedures.runs.request_file import request_hash
from procedures.runs.simulated_theatre import THEATRE_FOLDER, SimulatedRoom, SimulatedTheatre, scan_head
from ronna_hw.command_line.messages import fail_with, tell
from ronna_hw.control_port import VARIABLE
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import RUN_CHANGED
from ronna_hw.evidence.manifest import SCENE_FILE
from ronna_hw.host.files import require_open_files
from ronna_hw.host.process import ENDING_SIGNALS, defer_interruption, resume_garbage_collection
from ronna_hw.log_output import keep_log
from ronna_hw.registry import load_driver

if TYPE_CHECKING:
    from procedures.engine.engine import Engine
    from procedures.runs.engine_setup import EngineInput
    from procedures.runs.interrupted_run import InterruptedRun, Resumption
    from ronna_hw.theatre import Theatre

SENSOR_DRIVERS = ("ndi_polaris", "basler_stereo")  # of every simulated theatre
OPEN_FILES = 96  # a case was measured to have 41 open at once; the rest is room for plots and libraries


@contextlib.contextmanager
def open_run(
    request: RunRequest, folder: Path, observers: RunObservers, resumption: Resumption | None = None
) -> Iterator[Engine]:
    """Open a run's engine, ready for its first step, and close everything after the block.

    With `resumption` the folder is that of the interrupted run. The plan of a case is held meanwhile.
    """
    with contextlib.ExitStack() as held:
        phantom = None
        if isinstance(request.procedure, CaseProcedure):
            phantom = _find_missing_patient(request.procedure, folder, resumption)
        prepare = partial(_prepare, request, folder, resumption, held)
        with open_engine(request, folder, prepare, observers, resumption, phantom) as engine:
            yield engine


def _prepare(
    request: RunRequest,
    folder: Path,
    resumption: Resumption | None,
    held: contextlib.ExitStack,
    theatre: Theatre,
) -> EngineInput:
    """Prepare a run's engine input when its theatre is open but no device is connected yet."""
    from procedures.engine.order import order_of
    from procedures.runs.engine_setup import EngineInput

    match request.procedure:
        case CaseProcedure():
            from procedures.runs.case import prepare_case

            return prepare_case(request, folder, theatre, resumption, held)
        case CalibrationProcedure(recipe=plain):
            from procedures.runs.calibrations import KINDS
            from procedures.steps.calibration.recipe import Recipe

            read = Recipe.read(plain)
            kind = KINDS[read.of]
            steps, title, in_use, recipe = read.steps, kind.title, kind.in_use, read
        case Measurement(steps=steps, title=title, in_use=in_use, recipe=recipe):
            pass
        case None:
            raise AssertionError("the request has no procedure")
    return EngineInput(order_of(steps, ()), title, calibrations=in_use(theatre.calibrations), recipe=recipe)


def _find_missing_patient(case: CaseProcedure, folder: Path, resumption: Resumption | None) -> Path | None:
    """Return the folder where a simulated patient must be created, or None; clear an incomplete one."""
    from procedures.runs.case import case_folder

    patient = case_folder(case, folder)
    complete = case.case is None and (patient / "plan.toml").exists()  # the phantom's last file
    if resumption is not None and case.case is None and not complete:
        shutil.rmtree(patient, ignore_errors=True)
    return None if complete else patient


@contextlib.contextmanager
def open_engine(
    request: RunRequest,
    folder: Path,
    prepare: Callable[[Theatre], EngineInput],
    observers: RunObservers,
    resumption: Resumption | None = None,
    phantom: Path | None = None,
) -> Iterator[Engine]:
    """Open a theatre, and an engine for the steps that `prepare` returns; see `open_run`.

    A simulated patient is made in the folder `phantom`.
    """
    require_open_files(OPEN_FILES)
    with contextlib.ExitStack() as stack:
        stack.enter_context(keep_log(folder, run=folder.name, seed=request.seed))
        operator = operator_selection(request, observers, resumption)
        simulated, not_home, staff = None, None, None
        if request.config is not None:
            file = request.config
            only_leaving = resumption is not None and resumption.only_leaving
            not_home = _hold_theatre(file, folder, request.roles, stack, only_leaving=only_leaving)
            if request.ask and (control := os.environ.get(VARIABLE)):  # not needed to acknowledge a fault
                staff = SimulatedRoom(control)
        else:
            simulated = _start_simulated(request, folder, observers, resumption, phantom, stack)
            file = simulated.theatre.file
            staff = SimulatedRoom(simulated.theatre.control, partial(_scan_simulated, request, folder))
            stack.push(staff.tell_missed_faults(observers.announce))
        asks = resumption is None or resumption.asks
        room = _choose_staff(request, staff, observers, asks=asks)
        from procedures.engine.display_feed import publish_order
        from procedures.runs.engine_setup import build_engine

        engine = build_engine(
            folder,
            file,
            prepare,
            operator,
            room,
            stack,
            resumption,
            on_ending=ignore_further_signals,
            opening={**request_hash(folder), "seed": request.seed},
            arm_not_home=not_home,
        )
        resume_garbage_collection()
        if simulated is not None:
            simulated.keep_file()
        outcome, ended_by = "failed", None
        try:
            begin_report(folder)
            publish_order(engine)
            observers.opened(engine)
            with _build_device_watch(engine, fast=observers.executor is not None):
                yield engine
            engine.require_record()
            outcome = "done" if asks and engine.over else "left"
        except BaseException as problem:  # also an interruption: nothing may cut the way to rest short
            ignore_further_signals()
            if isinstance(problem, KeyboardInterrupt):
                outcome = "interrupted"
            ended_by = problem if isinstance(problem, RonnaError) else None
            raise
        finally:
            if (instrument := engine.setting.workcell.instrument_description) is not None:
                tell(f"{instrument}: the arm does not move")
            if engine.record_is_deleted:
                from procedures.runs.arm_notes import describe_arm_without_record

                place = engine.setting.workcell.master.place
                tell(describe_arm_without_record(place, own=simulated is not None))
            with defer_interruption():
                engine.close(outcome, ended_by)


def _scan_simulated(request: RunRequest, folder: Path) -> None:
    """Scan the head in the run's own theatre into its case, as the staff of a real one do."""
    from procedures.runs.case import clinical_input

    clinical = clinical_input(request.case, folder)
    scan_head(folder / THEATRE_FOLDER, request.choice.scene_seed, clinical.scan_folder)


def _hold_theatre(
    theatre: Path, run: Path, roles: Collection[str], stack: contextlib.ExitStack, *, only_leaving: bool
) -> str | None:
    """Lock a theatre file's devices; return a warning if an arm was left away from home."""
    from procedures.runs.arm_notes import find_former_run
    from procedures.runs.theatre_lock import hold_theatre

    notes = stack.enter_context(hold_theatre(theatre, run, roles, only_leaving=only_leaving))
    left = (find_former_run(note, run).not_home for note in notes)
    return "; ".join(dict.fromkeys(filter(None, left))) or None


def _choose_staff(
    request: RunRequest, simulated: SimulatedRoom | None, observers: RunObservers, *, asks: bool
) -> Room:
    """Return the staff of a run: the `simulated` ones, moved by a person's words if --ask, or real ones."""
    if simulated is not None and not request.ask:
        return simulated
    if simulated is not None:
        if asks and isinstance(request.procedure, CaseProcedure):
            # the person who is asked cannot see it
            observers.announce(f"the simulated patient's wristband reads {simulated.read_wristband()}")
        room = observers.by_word(simulated)
    else:
        from ronna_hw.config import read_theatre_file
        from ronna_hw.theatre_kind import is_simulated

        assert request.config is not None, "every other theatre has simulated staff"
        room = observers.staff(is_simulated(read_theatre_file(request.config)))
    return room if observers.executor is None else observers.executor.staff(room)


def _start_simulated(
    request: RunRequest,
    folder: Path,
    observers: RunObservers,
    resumption: Resumption | None,
    phantom: Path | None,
    stack: contextlib.ExitStack,
) -> SimulatedTheatre:
    """Start a run's simulated theatre and patient in the run's folder.

    Raises PRO-033 if it would continue in another scene.
    """
    if resumption is not None:
        _require_same_scene(folder, resumption.interrupted)
    continued = resumption is not None and not resumption.interrupted.untouched
    theatre = SimulatedTheatre(
        request, folder / "theatre", phantom, continued=continued, on_controller_message=observers.announce
    )
    simulated = stack.enter_context(theatre)
    with defer_interruption():  # NumPy can be imported only once, also by the report of an interrupted run
        for module in ("procedures.steps.catalogue", "procedures.runs.engine_setup"):
            importlib.import_module(module)  # a second of imports, meanwhile
        if phantom is not None:
            importlib.import_module("pydicom")  # for the first step; meanwhile, it costs no time
            from ronna_hw.arm.catalogue import list_drivers

            of_arms = (request.choice.arm, request.choice.assistant_arm)[: len(request.roles)]
            for driver in (*list_drivers(of_arms), *SENSOR_DRIVERS):
                load_driver(driver)
    if phantom is not None:
        observers.status("making the phantom CT")
        simulated.await_patient()
        observers.patient(phantom)
    observers.status("opening the theatre")
    simulated.await_theatre()
    observers.announce(f"control port {simulated.theatre.control}")
    return simulated


def _require_same_scene(folder: Path, interrupted: InterruptedRun) -> None:
    """Raise PRO-033 if the scene file was changed since the run left its simulated theatre."""
    for change in interrupted.run.changes:
        if change.file == SCENE_FILE:
            raise RUN_CHANGED(
                f"the simulated theatre cannot continue in {folder / SCENE_FILE}",
                expected="the scene that the run began with",
                got=f"one that is {change.what}",
                action="Put that file back from a copy and repeat the command, or start a new run. "
                "Nothing was moved.",
            )


def _build_device_watch(engine: Engine, *, fast: bool) -> contextlib.AbstractContextManager[object]:
    """Return a context that publishes devices and arm bodies, at a high rate if `fast`."""
    from procedures.engine.body_view import BodyView
    from procedures.engine.display_feed import PERIOD_S, SEEN_MOVING_S, DeviceWatch

    workcell = engine.setting.workcell
    now_s, period_s = engine.setting.clock.now_s, SEEN_MOVING_S if fast else PERIOD_S
    return DeviceWatch(workcell.devices, engine.events, now_s, period_s, BodyView(workcell))


def ignore_further_signals() -> None:
    """Ignore all further signals, so that a second one cannot interrupt the shutdown."""
    if threading.current_thread() is threading.main_thread():
        for number in ENDING_SIGNALS:
            signal.signal(number, signal.SIG_IGN)


def run_steps(
    request: RunRequest,
    folder: Path,
    observers: RunObservers,
    resumption: Resumption | None = None,
    conclude: Callable[[Engine], None] = lambda _engine: None,
) -> tuple[Engine, float]:
    """Run all steps that have no valid result, then `conclude`; return the engine and the theatre time in s.

    An error of `conclude` ends the run. With `resumption`, nothing moves until the findings are
    accepted. Raises the errors of steps, and PRO-032 for a run that is not resumed.
    """
    with open_run(request, folder, observers, resumption) as engine:
        if resumption is not None and not resumption.interrupted.untouched:
            from procedures.runs.recovery import recover

            if observers.executor is not None:
                observers.status(SEAT_AWAITED)
                observers.executor.await_operator()
            observers.status("comparing the theatre with the record")
            recover(engine, resumption.interrupted)
        run_to_end(engine, observers)
        conclude(engine)
        theatre_time_s = engine.setting.clock.now_s()  # the clock ends with its theatre
    return engine, theatre_time_s


def run_to_end(engine: Engine, observers: RunObservers) -> None:
    """Run the case to its end. After a failed step, any person at the prompt decides how to continue.

    A case refused only because of a device in fault ends with that fault.
    """
    from procedures.engine.display_feed import upcoming_name

    held, executor = observers.held, observers.executor
    failure: RonnaError | None = None
    failed_at: str | None = None  # the step that came next then
    acknowledged = 0  # before it
    run = engine.run_to if executor is None else partial(executor.run_to_end, engine)
    while True:
        try:
            run()
            if engine.course.over and not engine.over:  # a case has not ended while its arm is out
                engine.retreat_home()
            return
        except OperatorAborted:
            went_home = executor is not None and executor.has_led_home
            if held is not None and not went_home:
                leave_head_if_agreed(engine)
            raise
        except RonnaError as error:
            if held is None or engine.machine.ended or isinstance(error, RunDeleted):
                raise
            held.tell_held(engine, error)
            upcoming = upcoming_name(engine)
            only_fault = isinstance(error, StepRefused) and engine.faults.now and failed_at == upcoming
            if failure is None or not only_fault:
                failure, acknowledged = error, engine.faults.acknowledgements
                failed_at = upcoming
            if not held.follow(engine):
                failure.shown = True
                raise engine.faults.as_of_now(failure, acknowledged) from None


def leave_head_if_agreed(engine: Engine) -> None:
    """After an abort, retreat and park if the operator agrees. Errors are reported, not raised."""
    try:
        engine.leave_head()
    except RonnaError as error:
        fail_with(error)
