"""The engine of a procedure over a theatre file, with everything that records it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from procedures.composition.guarding import guard
from procedures.composition.procedure import Procedure, Resumption
from procedures.engine.case import Case
from procedures.engine.context import CaseSetting, this_second
from procedures.engine.engine import Engine
from procedures.engine.events import EventStream
from procedures.engine.events.event_file import EventFile
from procedures.engine.left_run import LeftRun
from procedures.engine.replay.sections import opening_line, section_follower
from procedures.journal.journal import ONLY_LEAVING, Entry, Journal, JournalValue
from procedures.operator.question import Operator
from procedures.operator.room import Room
from procedures.workcell import Workcell
from procedures.workcell.arm_history import UNMOVED
from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Device
from ronna_hw.evidence.manifest import input_hashes, theatre_files, truth_so_far
from ronna_hw.recording.flight_recorder import BYTES_FOLDER, FlightRecorder
from ronna_hw.recording.reading_tape import READINGS_FOLDER, ReadingTape, taped
from ronna_hw.registry import make_device
from ronna_hw.software import this_software
from ronna_hw.theatre import Theatre


@dataclass(frozen=True)
class People:
    """Who answers questions, and whose hands act in the room."""

    operator: Operator
    room: Room


def made_engine(
    folder: Path,
    file: Path,
    procedure: Callable[[Theatre], Procedure],
    people: People,
    stack: ExitStack,
    resumption: Resumption | None,
    *,
    on_ending: Callable[[], None],
    opening: Mapping[str, JournalValue],
    left_away: str | None = None,
) -> Engine:
    """The engine with its journal in `folder`; nothing is connected yet, and `stack` ends what records it.

    `procedure` is called with the theatre before the journal is opened, so what it raises leaves none.
    `opening` goes into the journal's first line; `left_away` says that another run left the arm away.
    """

    def make(name: str, config: DeviceConfig, clock: Clock) -> Device:
        return taped(make_device(name, config, clock), tape)

    theatre = Theatre.from_file(file, make)
    wanted = procedure(theatre)
    calibrations = wanted.calibrations or theatre.calibrations  # what is missing is known before the journal
    events = EventStream(theatre.clock.now_s)
    stack.callback(EventFile(folder, events).join)
    stack.callback(events.end)
    began = this_second()
    first = opening_line(folder, file, theatre.clock, wanted.clinical, began, wanted.as_plain(calibrations))
    tape = ReadingTape(folder / READINGS_FOLDER, theatre.clock.now_s, first)
    stack.callback(tape.close)
    follow = section_follower(tape)

    def written(line: bytes) -> None:
        follow(line)
        events.journal_line(line)

    def before_result() -> dict[str, JournalValue]:
        tape.settle()  # what stands can be computed again, also after a kill
        return truth_so_far(folder)

    left = None if resumption is None else resumption.left
    history = UNMOVED if left is None else left.arm
    case = Case(folder) if left is None else left.restored(wanted.order)
    if left is None or not left.has_journal:
        journal = Journal(folder, written)
    else:
        journal = Journal.taken_up(folder, left.chain, written)
    flight_recorder = FlightRecorder(folder / BYTES_FOLDER, theatre.clock.now_s)
    stack.callback(flight_recorder.close)
    theatre.record_bytes(flight_recorder)
    workcell = Workcell(
        theatre,
        journal,
        calibrations=calibrations,
        calibrating=wanted.calibrations is not None,
        history=history,  # at once: a run may be closed before it is compared with anything
    )
    _ = workcell.devices  # made now: what a driver refuses is said before the first line of the journal
    journal.write(
        Entry.RESTARTED if left is not None and left.run.journal else Entry.OPENED,
        theatre.clock.now_s(),
        **({} if left is None else left.as_plain()),
        **({ONLY_LEAVING: True} if resumption is not None and resumption.only_leaving else {}),
        **opening,
        **truth_so_far(folder),
        inputs=_theatre_inputs(folder, left),
        run=case.run,
        software=str(this_software()),
        theatre=theatre.file.theatre,
        banner=theatre.file.banner,
        procedure=wanted.title,
        strategy=None if wanted.clinical is None else wanted.clinical.strategy.name,
        plan_sha256=None if wanted.clinical is None else wanted.clinical.plan_sha256,
    )
    engine = Engine(
        wanted.order,
        case,
        CaseSetting(
            workcell=workcell,
            clock=theatre.clock,
            operator=people.operator,
            room=people.room,
            settings=theatre.file.procedure,
            surroundings=theatre.file.cell_with_tools,
            clinical=wanted.clinical,
            left_away=left_away,
            starts=frozenset() if wanted.recipe is None else wanted.recipe.starts,
            began=began,
        ),
        journal,
        events=events,
        on_ending=on_ending,
        before_result=before_result,
        recorders=(flight_recorder, tape),
        recovering=left is not None and not left.untouched,
        latest=None if left is None else left.latest,
    )
    engine.checkpoint.beside = tape.beside
    guard(engine, file, theatre.file, only_leaving=resumption is not None and resumption.only_leaving)
    return engine


def _theatre_inputs(folder: Path, left: LeftRun | None) -> dict[str, JournalValue]:
    """Hashes of the theatre in the run's folder, without what was changed or added before it is resumed."""
    known = () if left is None else left.not_as_left
    hashes = input_hashes(folder, theatre_files(folder))
    return {name: sha256 for name, sha256 in hashes.items() if name not in known}
