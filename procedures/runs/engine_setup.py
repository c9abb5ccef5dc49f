"""Construction of a run's engine on a theatre file, with its journal, recorders and guards."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.calibration.errors import PlatformMoved
from procedures.engine.case import Case, StepKey
from procedures.engine.engine import Engine
from procedures.engine.events import Advisory, EventStream
from procedures.engine.events.event_file import EventFile
from procedures.engine.replay.recorded_answers import opening_line, section_follower
from procedures.engine.setting import CaseSetting, now_to_second
from procedures.guards import (
    GuideDisplacement,
    HeadInSight,
    TrackerLink,
    UnchangedRecords,
    case_guards,
    patient_watch,
)
from procedures.guards.errors import BaseShifted
from procedures.journal.journal import JOURNAL_FILE, ONLY_LEAVING, Entry, Journal, JournalValue
from procedures.live.feed import LiveFeed
from procedures.operator.question import Operator, Room
from procedures.runs.arm_comparison import look_with_instrument_in_guide
from procedures.runs.interrupted_run import InterruptedRun, Resumption
from procedures.steps.branches import CART_MOVED, GO_ON
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.inputs import UnchangedInputs
from procedures.steps.clinical.room import void_moved
from procedures.steps.clinical.work_progress import work_begun_elsewhere
from procedures.workcell import Workcell
from procedures.workcell.arm_history import ArmHistory, fold_history
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig, TheatreFile
from ronna_hw.devices.lifecycle import Device
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.manifest import hash_inputs, hash_truth_files, list_theatre_files, sha256_of
from ronna_hw.host.processor import name_processor
from ronna_hw.recording.flight_recorder import BYTES_FOLDER, FlightRecorder
from ronna_hw.recording.reading_tape import READINGS_FOLDER, ReadingTape, tape_device
from ronna_hw.registry import make_device
from ronna_hw.roles import ONE_ARM
from ronna_hw.software import identify_software
from ronna_hw.theatre import Theatre

if TYPE_CHECKING:
    from procedures.engine.order import CaseOrder
    from procedures.engine.setting import ClinicalInput
    from procedures.steps.calibration.recipe import Recipe
    from ronna_hw.config import Calibrations

MOST_MOVES = 3  # per program of a run: a cart that keeps moving needs another lock, not another localization


@dataclass(frozen=True)
class EngineInput:
    """Steps for the engine to run, with their inputs.

    `calibrations` replace those of the theatre file. A replay makes a calibration's steps from its `recipe`.
    """

    order: CaseOrder
    title: str | None = None  # of a procedure that is no clinical case
    clinical: ClinicalInput | None = None
    calibrations: Calibrations | None = None
    recipe: Recipe | None = None

    def as_plain(self, in_use: Calibrations) -> dict[str, object] | None:
        """Return the recipe and the calibrations used, for a replay, or None without a recipe."""
        if self.recipe is None:
            return None
        records = in_use.model_dump(mode="json", exclude_none=True)
        return {"recipe": self.recipe.model_dump(mode="json"), "records": records}


def build_engine(
    folder: Path,
    file: Path,
    prepare: Callable[[Theatre], EngineInput],
    operator: Operator,
    room: Room,
    stack: ExitStack,
    resumption: Resumption | None,
    *,
    on_ending: Callable[[], None],
    opening: Mapping[str, JournalValue],
    arm_not_home: str | None = None,
) -> Engine:
    """Build an engine with its journal in `folder`, without connecting devices; `stack` closes recorders.

    `prepare` is called with the theatre before the journal is opened: its errors leave no journal.
    `opening` goes into the journal's first line; `arm_not_home` says that another run left the arm away.
    """

    def make(name: str, config: DeviceConfig, clock: Clock) -> Device:
        return tape_device(make_device(name, config, clock), tape, feed.tap)

    theatre = Theatre.from_file(file, make)
    prepared = prepare(theatre)
    # What is missing is known before the journal.
    calibrations = prepared.calibrations or theatre.calibrations
    events = EventStream(theatre.clock.now_s)
    stack.callback(EventFile(folder, events).join)
    stack.callback(events.end)
    began = now_to_second()
    clinical, recipe = prepared.clinical, prepared.as_plain(calibrations)
    first = opening_line(folder, file, theatre.clock, clinical, began, recipe)
    tape = ReadingTape(folder / READINGS_FOLDER, theatre.clock.now_s, first, starts=False)
    stack.callback(tape.close)
    feed = LiveFeed(folder, theatre.clock, events)
    stack.callback(feed.close)
    follow = section_follower(tape)

    def publish_line(line: bytes) -> None:
        follow(line)
        events.journal_line(line)

    def before_result() -> dict[str, JournalValue]:
        tape.settle()  # what stands can be computed again, also after a kill
        return hash_truth_files(folder)

    previous = None if resumption is None else resumption.interrupted
    only_leaving = resumption is not None and resumption.only_leaving
    case = Case(folder) if previous is None else previous.restore_case(prepared.order)
    if previous is None or not (folder / JOURNAL_FILE).exists():
        journal = Journal(folder, publish_line)
    else:
        journal = Journal.reopen_run(folder, previous.run.chain, publish_line)
    flight_recorder = FlightRecorder(folder / BYTES_FOLDER, theatre.clock.now_s)
    stack.callback(flight_recorder.close)
    theatre.record_bytes(flight_recorder)
    workcell = Workcell(
        theatre,
        journal,
        calibrations=calibrations,
        calibrating=prepared.calibrations is not None,
        histories=_arm_histories(clinical, previous),
        enhance_contrast=clinical is not None and clinical.methods.enhance_contrast,
    )
    _ = workcell.devices  # made now: what a driver refuses is said before the first line of the journal
    journal.write(
        Entry.RESTARTED if previous is not None and previous.run.journal else Entry.OPENED,
        theatre.clock.now_s(),
        **({} if previous is None else previous.as_plain()),
        **({ONLY_LEAVING: True} if only_leaving else {}),
        **opening,
        **hash_truth_files(folder),
        inputs=theatre_inputs(folder, previous),
        theatre_sha256=sha256_of(file),
        run=case.run,
        software=str(identify_software()),
        processor=name_processor(),
        theatre=theatre.file.theatre,
        banner=theatre.file.banner,
        procedure=prepared.title,
        strategy=None if clinical is None else clinical.strategy.name,
        methods=None if clinical is None else clinical.methods.describe(),
        plan_sha256=None if clinical is None else clinical.plan_sha256,
    )
    tape.start()  # a program killed before its first line in the journal leaves the tape as it was
    engine = Engine(
        prepared.order,
        case,
        CaseSetting(
            workcell=workcell,
            clock=theatre.clock,
            operator=operator,
            room=room,
            settings=theatre.file.procedure,
            surroundings=theatre.file.cell_with_tools,
            clinical=clinical,
            arm_not_home=arm_not_home,
            starts=frozenset() if prepared.recipe is None else prepared.recipe.starts,
            began=began,
        ),
        journal,
        events=events,
        on_ending=on_ending,
        before_result=before_result,
        recorders=(flight_recorder, tape, feed),
        recovering=previous is not None and not previous.untouched,
        latest=None if previous is None else previous.latest,
    )
    engine.checkpoint.beside = tape.beside
    engine.look_before_retreat = lambda: look_with_instrument_in_guide(engine)
    workcell.motion.reading = tape.in_this_thread
    add_guards(engine, file, theatre.file, only_leaving=only_leaving)
    feed.follow(engine)
    return engine


def _arm_histories(
    clinical: ClinicalInput | None, previous: InterruptedRun | None
) -> Mapping[str, ArmHistory]:
    """Return the history of each arm at once: a run may be closed before it is compared with anything."""
    roles = ONE_ARM if clinical is None else clinical.roles
    if previous is None:
        return {role: ArmHistory(role) for role in roles}
    return {role: fold_history(previous.run.chain, previous.run.lost, role) for role in roles}


def theatre_inputs(folder: Path, previous: InterruptedRun | None) -> dict[str, JournalValue]:
    """Hash the theatre files in a run's folder, except files changed or added since the run last ended."""
    known = () if previous is None else previous.run.not_as_left
    hashes = hash_inputs(folder, list_theatre_files(folder))
    return {name: sha256 for name, sha256 in hashes.items() if name not in known}


def add_guards(engine: Engine, file: Path, theatre: TheatreFile, *, only_leaving: bool = False) -> None:
    """Install a run's guards; `theatre` is the theatre file's content at the start of the run.

    With `only_leaving` the inputs are not compared: whatever has changed, the arm may go home.
    """
    setting, guards = engine.setting, engine.checkpoint.guards
    workcell = setting.workcell
    workcell.on_stop_failed = lambda failure: engine.events.publish(Advisory(text=failure))
    folder = engine.case.folder
    guards.extend(case_guards(workcell, folder, engine.find, engine.doubt_tool))
    if not only_leaving:
        guards.append(
            UnchangedRecords(
                file, theatre, lambda: engine.running is not None and not workcell.master.place.is_on_axis
            )
        )
    link = TrackerLink(workcell.tracker, setting.memory, setting.clock.now_s)
    if setting.clinical is None:
        guards.append(link)
        return
    engine.goes_on = MovedCart(engine).continues_by_consent
    if not only_leaving:
        inputs = UnchangedInputs(engine, setting.clinical)
        guards.append(inputs)
        engine.recorders.append(inputs)
    void = partial(void_moved, engine.context(StepKey(GlobalLocalization.kind)))
    guards.append(GuideDisplacement(workcell, setting.memory))  # before the head: it names the cause
    guards.append(HeadInSight(workcell, setting.memory, void, engine.find))
    guards.append(link)  # last: it also judges the replies to the guards before it
    engine.checkpoint.watching = patient_watch(engine, void).watching


class MovedCart:
    """Handles a moved cart of either arm: the case continues if the operator agrees, once every arm is home.

    While an instrument is or may be inside the head, nobody is asked and nothing moves: the case is held, and
    leaves the head by an order of its own.
    """

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._moves = 0

    def continues_by_consent(self, problem: RonnaError) -> bool:
        """Ask whether to continue after a cart move; if so, bring every arm home and return True.

        Raises the errors of the way home.
        """
        engine, workcell = self._engine, self._engine.setting.workcell
        has_moved = isinstance(problem, BaseShifted | PlatformMoved)
        if not has_moved or self._moves == MOST_MOVES or engine.machine.ended:
            return False
        if (inside := engine.instrument_in) is not None:
            engine.find(
                f"the case is held: {problem.summary}, while an instrument is or may be inside at {inside}. "
                "Nothing moves: the surgeon judges the instrument first; then take it out, send "
                f"{workcell.phrases.arms} home and continue from there",
                (inside,),
            )
            return False
        self._moves += 1
        if (following := engine.upcoming) is None:
            goes_on = (
                f"lock it; the work at every target is done: {workcell.phrases.going_home} and the case ends"
            )
        else:
            goes_on = f"lock it; {workcell.phrases.going_home}, and {following} is next"
        stands = ", ".join(dict.fromkeys(stored.record.kind for stored in engine.case.valid_results))
        begun = work_begun_elsewhere(engine)
        value = (f"nobody is in {workcell.phrases.ways} home; these results remain valid: {stands}", *begun)
        question = CART_MOVED.question(f"{problem.summary}: {goes_on}", "; ".join(value))
        if engine.ask(question) != GO_ON:
            return False
        if following is None or not workcell.master.place.is_home:
            engine.retreat_home()
        return True
