"""Replay of an ended or killed run: steps in journal order, using recorded answers."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import datetime
from enum import StrEnum
from pathlib import Path

from procedures.engine.case import Case
from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.errors import NotRecorded, ReadingsChanged
from procedures.engine.order import CaseOrder, StepSpec
from procedures.engine.replay.recorded_answers import BEGINS, RecordedAnswers
from procedures.engine.replay.recorded_people import (
    RecordedClock,
    RecordedOperator,
    RecordedRoom,
    make_stand_in,
)
from procedures.engine.run_folder import step_key
from procedures.engine.setting import CaseSetting, ClinicalInput
from procedures.journal.errors import StepRefused
from procedures.journal.journal import ENDS_OF_A_STEP, Entry, Journal, Line
from procedures.journal.results import StepResult
from procedures.workcell import Workcell
from procedures.workcell.arm_history import ArmHistory, arm_history
from procedures.workcell.arms import ReplayedArms
from ronna_hw.clock import Clock
from ronna_hw.config import Calibrations, DeviceConfig, TheatreFile
from ronna_hw.devices.lifecycle import Device, Lifecycle
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.inspection import Inspection
from ronna_hw.records import Record
from ronna_hw.registry import make_device
from ronna_hw.roles import MASTER
from ronna_hw.theatre import Theatre

MOST_DIFFERENCES = 5  # that are named
# What another processor's arithmetic may change in a number, by the unit that its field's name ends with.
# Measured on five cases recorded on one kind and computed again on another: up to 5e-6 mm and 7e-9 rad.
ROUNDING = {"_mm": 1e-5, "_rad": 1e-7, "_wxyz": 1e-7}
ROUNDING_SHARE = 1e-3  # of any other number; a covariance in those cases: 1e-4
ShowRecord = Callable[[int, int], None]  # records done, of how many


class ReplayVerdict(StrEnum):
    """Verdict of a replay on one record, or on a step that failed and has none."""

    EQUAL = "equal"
    ROUNDED = "rounded"
    DIFFERENT = "different"
    NOT_RECORDED = "not recorded"
    CHANGED = "changed"
    NO_RESULT = "no result"


@dataclass(frozen=True)
class ReplayedRecord:
    """Verdict on one record; `why` lists the differences or explains why it was not recomputed.

    A step that failed has no record; `why` says with which code it failed, and how it ended again.
    """

    record: str
    step: str
    verdict: ReplayVerdict
    why: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Difference:
    text: str
    rounding: bool = False


def compare_records(
    step: str, recorded: Record, again: Record, result: type[StepResult] = StepResult
) -> ReplayedRecord:
    """Compare payloads: equal if identical, rounded if all differences are within rounding limits.

    Those of an older program have today's names of their fields.
    """
    found = list(_differences(result.renew(recorded.payload), again.payload, ""))
    real = [one for one in found if not one.rounding]
    verdict = ReplayVerdict.DIFFERENT if real else ReplayVerdict.ROUNDED if found else ReplayVerdict.EQUAL
    why = tuple(one.text for one in (real or found)[:MOST_DIFFERENCES])
    return ReplayedRecord(recorded.identifier, step, verdict, why)


def _differences(was: object, now: object, where: str, field: str = "") -> Iterator[_Difference]:
    if isinstance(was, Mapping) and isinstance(now, Mapping):
        for name in dict.fromkeys((*was, *now)):
            inside = f"{where}.{name}" if where else str(name)
            if was.get(name) is None and now.get(name) is None:
                continue  # an optional field that one of both versions did not know
            if name not in was or name not in now:
                yield _Difference(f"{inside}: {'recorded' if name in was else 'computed'} only")
            else:
                yield from _differences(was[name], now[name], inside, str(name))
    elif isinstance(was, list | tuple) and isinstance(now, list | tuple) and len(was) == len(now):
        for place, (one, other) in enumerate(zip(was, now, strict=True)):
            yield from _differences(one, other, f"{where}[{place}]", field)
    elif was != now:
        rounding = isinstance(was, float) and isinstance(now, float) and _is_rounding(field, was, now)
        yield _Difference(f"{where}: {_short(was)} recorded, {_short(now)} computed", rounding)


def _is_rounding(field: str, was: float, now: float) -> bool:
    limits = [limit for unit, limit in ROUNDING.items() if field.endswith(unit)]
    return abs(was - now) <= (limits[0] if limits else ROUNDING_SHARE * max(abs(was), abs(now)))


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."


@dataclass(frozen=True)
class ReplayInput:
    """Step order, inputs and theatre of the original run."""

    order: CaseOrder
    clinical: ClinicalInput | None  # of what is no calibration
    theatre: TheatreFile
    calibrations: Calibrations | None = None  # those in use, where they were not the theatre file's
    starts: frozenset[str] = frozenset()  # of a calibration: the records that it only starts from


def replay(
    run: Inspection,
    replay_input: ReplayInput,
    answers: RecordedAnswers,
    progress: ShowRecord = lambda _done, _of: None,
) -> tuple[ReplayedRecord, ...]:
    """Replay the run and return a verdict on every record, and on every step that failed, in order.

    Later steps read recomputed results, not recorded ones: a difference shows in all that follow. Opens no
    device and writes to a temporary folder only.
    """
    with tempfile.TemporaryDirectory(prefix="ronna-replay-") as folder:
        again = _Replay(run, replay_input, answers, Path(folder))
        results: list[ReplayedRecord] = []
        for one in again.run():
            results.append(one)
            progress(sum(bool(result.record) for result in results), len(run.records))
        return tuple(results)


class _RecordedStops:
    """Pseudo-guard that repeats recorded arm stops, so that the next motion counts as a first motion.

    It is asked before each motion, like a guard, and is always met.
    """

    name = "recorded stops"

    def __init__(self, operator: RecordedOperator, workcell: Workcell) -> None:
        self._operator = operator
        self._workcell = workcell
        self._before = 0

    def begin(self) -> None:
        """Restart the motion count for a new section."""
        self._before = self._motions()

    def unmet(self) -> None:
        asked_of = self._operator.find_first_to_move(self._motions() - self._before)
        for arm in self._workcell.arms.values():
            if arm.history.arm == asked_of:
                arm.supervised.reset_confirmation()

    def _motions(self) -> int:
        return sum(arm.history.motions for arm in self._workcell.arms.values())


class _Replay:
    def __init__(
        self, run: Inspection, replay_input: ReplayInput, answers: RecordedAnswers, folder: Path
    ) -> None:
        def make(name: str, config: DeviceConfig, clock: Clock) -> Device:
            return make_stand_in(make_device(name, config, clock), answers)

        self._run = run
        self._answers = answers
        self._operator = RecordedOperator()
        self._room = RecordedRoom()
        self._uncomputed = ReplayVerdict.DIFFERENT  # verdict on the last step that could not be computed
        clock = RecordedClock(answers)
        self._theatre = theatre = Theatre(replay_input.theatre, clock, make)
        journal = Journal(folder)
        began = datetime.fromisoformat(str(run.opened["host_time"]))
        roles = (MASTER,) if replay_input.clinical is None else replay_input.clinical.roles
        setting = CaseSetting(
            workcell=Workcell(
                theatre,
                journal,
                calibrations=replay_input.calibrations,
                calibrating=replay_input.calibrations is not None,
                histories={role: ArmHistory(role) for role in roles},
                make_arms=ReplayedArms,
                enhance_contrast=answers.opening.methods.enhance_contrast,
            ),
            clock=clock,
            operator=self._operator,
            room=self._room,
            settings=replay_input.theatre.procedure,
            surroundings=replay_input.theatre.cell_with_tools,
            clinical=replay_input.clinical,
            starts=replay_input.starts,
            today=lambda: began,
            began=answers.opening.began or began,
        )
        steps = tuple(_without_preconditions(step, answers) for step in replay_input.order.steps)
        self._engine = Engine(replace(replay_input.order, steps=steps), Case(folder), setting, journal)
        self._stops = _RecordedStops(self._operator, setting.workcell)
        self._engine.checkpoint.guards.append(self._stops)
        self._engine.compare_places = lambda: None  # what was measured between steps is in the journal

    def run(self) -> Iterator[ReplayedRecord]:
        """Replay every section of the run in order."""
        records = {record.identifier: record for record in self._run.records}
        for begin, line, following in self._sections():
            self._answers.begin(begin)
            # A step that was killed is not run here, and one that a guard ended may go farther than it did.
            workcell, before = self._engine.setting.workcell, self._run.journal[:begin]
            for role, arm in workcell.arms.items():
                arm.restore_history(arm_history(before, role))
            self._operator.begin(following)
            self._stops.begin()
            self._room.begin([one for one in following if one["entry"] == Entry.WORK])
            end = next((one for one in following if one["entry"] in ENDS_OF_A_STEP), None)
            if line["entry"] == Entry.HOME:
                with suppress(RonnaError):
                    self._engine.retreat_home()
            elif end is not None and end["entry"] == Entry.RESULT:
                yield self._recompute(str(line["step"]), records[str(end["record"])])
            elif end is not None and end["entry"] == Entry.FAILED:
                yield self._fail_again(str(line["step"]), str(end["code"]))
            for one in following:
                if one["entry"] == Entry.ACKNOWLEDGED:
                    self._engine.faults.acknowledge(str(one["by"]))
                elif one["entry"] == Entry.VOIDED:
                    # Seen by a watch or a guard; what the step saw itself is gone already.
                    self._engine.course.void(step_key(one))
                elif one["entry"] == Entry.RESTARTED:
                    self._rest_devices()
                    self._engine.setting.memory.clear()
                    for arm in workcell.arms.values():  # a new program does not know how it came to rest
                        arm.supervised.ended = None
                elif one["entry"] == Entry.FOUND:  # the tracker looked while nothing streamed
                    self._rest_devices()
        self._engine.close("replayed")

    def _recompute(self, step: str, recorded: Record) -> ReplayedRecord:
        key = self._engine.order.find(step)
        try:
            again = self._engine.run_step(key)
        except StepRefused as error:  # what it needs was not computed either
            why = f"not computed: {error.summary}"
            return ReplayedRecord(recorded.identifier, step, self._uncomputed, (why,))
        except NotRecorded as error:
            is_changed = isinstance(error, ReadingsChanged)
            self._uncomputed = ReplayVerdict.CHANGED if is_changed else ReplayVerdict.NOT_RECORDED
            return ReplayedRecord(recorded.identifier, step, self._uncomputed, (error.summary,))
        except Exception as error:  # other numbers may fail anywhere in a step
            self._uncomputed = ReplayVerdict.DIFFERENT
            return ReplayedRecord(recorded.identifier, step, self._uncomputed, (f"not computed: {error}",))
        return compare_records(step, recorded, again, self._engine.order.spec(key).result)

    def _fail_again(self, step: str, code: str) -> ReplayedRecord:
        """Run a step that failed; say how it ends now.

        One that a guard ended may go farther than it did: what guards read is not kept.
        """
        try:
            self._engine.run_step(self._engine.order.find(step))
            again = "recomputed, it does not fail"
        except RonnaError as problem:
            again = f"recomputed, with {problem.code}: {problem.what}"
            if problem.code == code:
                again = "recomputed, with the same"
        except Exception as problem:
            again = f"recomputed, with {problem}"
        return ReplayedRecord("", step, ReplayVerdict.NO_RESULT, (f"failed with {code}; {again}",))

    def _rest_devices(self) -> None:
        """Return open devices to the configured state, so that the next motion counts as a first motion."""
        for device in self._theatre.devices.values():
            if device.state is not Lifecycle.DISCONNECTED:
                device.recover("")
        self._engine.setting.workcell.stop()

    def _sections(self) -> Iterator[tuple[int, Line, list[Line]]]:
        """Yield number, first line and subsequent lines of each section."""
        lines = self._run.journal
        begins = [place for place, line in enumerate(lines) if line["entry"] in BEGINS]
        for begin, end in zip(begins, [*begins[1:], len(lines)], strict=True):
            yield begin, lines[begin], list(lines[begin + 1 : end])


def _without_preconditions(step: StepSpec[StepResult], answers: RecordedAnswers) -> StepSpec[StepResult]:
    """Make a step's preconditions peek at answers without consuming them; missing answers count as met."""

    def unmet(context: StepContext) -> tuple[str, ...]:
        try:
            with answers.peek():
                return step.preconditions(context)
        except NotRecorded:
            return ()

    return replace(step, preconditions=unmet)
