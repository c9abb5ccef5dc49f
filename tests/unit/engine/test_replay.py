"""A replay recomputes from the recording, detects every difference and accesses no device."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
from bounded_cost import bounded_cost
from handmade_ur import UR5E_A, HandmadeController
from plain_steps import Approach, Fit, Held, Image, Localization, plain_order
from recording_cell import GUIDE, HOME, RecordingArm, RecordingCell, RecordingTheatre

from drivers.kuka_rsi.errors import STREAM_ERRORS
from drivers.universal_robots import UniversalRobotsArm
from procedures.engine.context import StepContext
from procedures.engine.errors import NotRecorded, ReadingsChanged
from procedures.engine.order import CaseOrder, Outcome
from procedures.engine.replay.recorded_answers import iterate_readings, read_answers, section_follower
from procedures.engine.replay.recorded_people import KNOWN_MEMBERS, RecordedOperator, make_stand_in
from procedures.engine.replay.replay import ReplayedRecord, ReplayInput, ReplayVerdict, replay
from procedures.engine.setting import ClinicalInput
from procedures.journal.errors import GateFailed
from procedures.journal.journal import Entry, Journal, read_journal
from procedures.operator.question import Question, Topic
from procedures.workcell import InsertionAxis, MountedTool
from procedures.workcell.arm_history import arm_history
from ronna_hw.clock import HostClock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices import ConfirmedStart, OpticalTracker, RobotArm, StereoPair
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import StereoReading
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.recording.reading_coding import PIXELS, pack_pixels
from ronna_hw.recording.reading_tape import (
    PIXELS_FILE,
    READINGS_FILE,
    READINGS_FOLDER,
    ReadingTape,
    tape_device,
)
from ronna_hw.roles import ASSISTANT, MASTER

STRETCHED_RAD = (0.0,) * 6
EQUAL, DIFFERENT, NOT_RECORDED = ReplayVerdict.EQUAL, ReplayVerdict.DIFFERENT, ReplayVerdict.NOT_RECORDED


def looks(context: StepContext) -> Outcome[Localization]:
    """A number from where the arm stands."""
    context.result(Image)
    return Outcome(Localization(number=round(1e6 * context.workcell.master.joints_rad()[0])))


def moves(context: StepContext) -> Outcome[Approach]:
    """By way of home where the straight way is not clear; a number from where it ended."""
    context.workcell.master.set_home()
    target = context.workcell.master.joints_rad()
    reached = context.workcell.master.go((target[0] + 0.25, *target[1:]))
    context.choose(Question(Topic.APPROACH, "go on", "now", trajectory=context.trajectory))
    return Outcome(Approach(number=round(1e6 * reached.joints_rad[0])))


def fits(context: StepContext) -> Outcome[Fit]:
    return Outcome(Fit(number=2 * context.result(Localization).number))


class Recorded:
    """A run of plain steps on an arm whose answers are recorded."""

    def __init__(self, folder: Path, **works: Callable[[StepContext], Outcome[Any]]) -> None:
        self.folder = folder
        self.order = plain_order("T1", **{"localization": looks, "fit": fits, "approach": moves, **works})
        self.cell = cell = RecordingCell(folder)
        cell.arm = RecordingArm("robot.master", state=Lifecycle.ACTIVE)
        tape = ReadingTape(folder / READINGS_FOLDER, lambda: 1.0, {"paced": True})
        (folder / "journal.jsonl").unlink()
        cell.journal = Journal(folder, section_follower(tape))
        cell.journal.write(Entry.OPENED, 0.0)
        cell.opened = RecordingTheatre(cell.theatre, tape_device(cell.arm, tape), cell.stereo, cell.tracker)  # type: ignore[arg-type]
        cell.workcell = cell.make_workcell()
        self.engine = cell.engine(self.order)
        self.tape, self.engine.recorders = tape, [tape]

    def run(self, *steps: str) -> None:
        for name in steps:
            try:
                self.engine.run_step(self.order.find(name))
            except GateFailed:
                continue

    def end(self) -> None:
        """End the run before it is replayed."""
        self.engine.close("left")
        self.engine.close = lambda _outcome: None  # type: ignore[method-assign]

    def replayed(self, order: CaseOrder | None = None) -> list[ReplayedRecord]:
        self.engine.close("left")
        clinical = ClinicalInput(self.cell.series, self.cell.plan, self.cell.strategy)
        given = ReplayInput(order or self.order, clinical, self.cell.theatre)
        return list(replay(inspect_run(self.folder), given, read_answers(self.folder)))

    def edit(self, change: Callable[[dict[str, Any]], None]) -> None:
        """Change every recorded answer."""
        self.end()
        path = self.folder / READINGS_FOLDER / READINGS_FILE
        lines = [json.loads(line) for line in path.read_text().splitlines()]
        for line in lines:
            if "answer" in line:
                change(line)
        path.write_text("".join(json.dumps(line) + "\n" for line in lines))


def verdicts(results: list[ReplayedRecord]) -> dict[str, ReplayVerdict]:
    return {result.step: result.verdict for result in results}


CASE = ("image", "localization:T1", "fit:T1", "tool_on", "approach:T1", "held:T1")


def test_a_replay_equals_its_run_even_where_a_path_was_blocked(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)
    blocked = iter([True, False, False, False])  # the straight way; below home, home and on from there
    recorded.cell.arm.blocked = lambda _start, _target: next(blocked)
    recorded.run(*CASE)
    assert len(recorded.cell.arm.motions) == 3
    assert verdicts(recorded.replayed()) == dict.fromkeys(CASE, EQUAL)


def test_a_run_whose_motions_were_recorded_as_the_two_calls_of_then_is_replayed(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)
    recorded.run(*CASE)
    earlier: list[str] = []

    def rename(line: dict[str, Any]) -> None:
        if line["call"] == "move":
            line["call"] = ("move_joints", "move_linear")[len(earlier) % 2]
            earlier.append(line["call"])

    recorded.edit(rename)
    assert earlier
    assert verdicts(recorded.replayed()) == dict.fromkeys(CASE, EQUAL)


def test_a_replay_equals_a_run_whose_arm_was_stopped_between_two_motions(tmp_path: Path) -> None:
    stops = iter([True, False])

    def moves_twice(context: StepContext) -> Outcome[Approach]:
        outcome = moves(context)
        if next(stops):  # by somebody else, in the run alone
            context.workcell.stop()
        target = context.workcell.master.joints_rad()
        context.workcell.master.go((target[0] + 0.5, *target[1:]))
        return replace(outcome, result=Approach(number=round(1e6 * context.workcell.master.joints_rad()[0])))

    recorded = Recorded(tmp_path, approach=moves_twice)
    recorded.run(*CASE)
    asked = [question.topic for question in recorded.cell.operator.asked]
    assert asked == [Topic.FIRST_MOTION, Topic.APPROACH, Topic.FIRST_MOTION]
    assert verdicts(recorded.replayed()) == dict.fromkeys(CASE, EQUAL)


class Occluded:
    """A guard that is unmet once after a motion was stopped, until the operator was asked."""

    name = "line of sight"

    def __init__(self, arm: RecordingArm) -> None:
        self._arm = arm
        self.asked = False

    def let_pass(self, asked: Topic) -> None:
        self.asked |= asked is Topic.GUARD

    def unmet(self) -> str | None:
        return "something is in the way" if self._arm.state is Lifecycle.HOLD and not self.asked else None


def test_a_replay_equals_a_run_that_a_guard_suspended_during_a_motion(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # It has a code, as a tape wants.
    monkeypatch.setattr("recording_cell.MotionInterrupted", STREAM_ERRORS.stopped)
    monkeypatch.setattr("procedures.operator.checkpoint.PATIENCE_S", 0.0)
    recorded = Recorded(tmp_path)
    guard = Occluded(recorded.cell.arm)
    recorded.engine.checkpoint.guards.append(guard)
    recorded.cell.operator.meanwhile = lambda question: guard.let_pass(question.topic)
    recorded.cell.arm.interruptions = 1
    recorded.run(*CASE)
    asked = [question.topic for question in recorded.cell.operator.asked]
    assert asked == [Topic.FIRST_MOTION, Topic.GUARD, Topic.FIRST_MOTION, Topic.APPROACH]
    assert verdicts(recorded.replayed()) == dict.fromkeys(CASE, EQUAL)


class Killed(BaseException):
    """The program ends without a word."""


def restarted(recorded: Recorded) -> None:
    """As a new program finds the devices: connected and configured, and nothing confirmed."""
    recorded.cell.arm.state = Lifecycle.CONFIGURED
    recorded.cell.workcell.stop()
    recorded.cell.workcell.master.supervised.ended = None
    recorded.engine.setting.memory.clear()
    recorded.engine.machine.hold()
    recorded.cell.journal.write(Entry.RESTARTED, 0.0)
    recorded.cell.workcell.master.restore_history(arm_history(read_journal(recorded.cell.journal.path)))


@pytest.mark.hazard(2)
def test_a_replay_equals_a_resumed_run(tmp_path: Path) -> None:
    def rests_and_moves(context: StepContext) -> Outcome[Localization]:
        if context.done_before:
            context.workcell.rest()  # nothing streams in a new program
        if context.setting.memory.find(int) is not None:
            context.workcell.master.joints_rad()
        context.setting.memory.keep(1)  # a new program has kept nothing
        moves(context)
        return looks(context)

    recorded = Recorded(tmp_path, localization=rests_and_moves)
    recorded.run("image", "localization:T1")
    restarted(recorded)
    recorded.run("localization:T1")
    assert {one.verdict for one in recorded.replayed()} == {EQUAL}


@pytest.mark.hazard(2)
def test_a_replay_knows_no_more_than_a_new_program_of_how_the_arm_came_home(tmp_path: Path) -> None:
    def tells_its_rest(context: StepContext) -> Outcome[Localization]:
        master = context.workcell.master
        if not context.done_before:
            moves(context)
            master.return_home()
        return Outcome(Localization(number=len(master.rest_sides or ())))

    recorded = Recorded(tmp_path, localization=tells_its_rest)
    recorded.run("image", "localization:T1")
    restarted(recorded)
    recorded.run("localization:T1")
    numbers = [one.payload["number"] for one in inspect_run(tmp_path).records if one.kind == "localization"]
    assert numbers == [6, 0]
    assert {one.verdict for one in recorded.replayed()} == {EQUAL}


def test_a_replay_equals_a_run_killed_before_its_devices_were_opened(tmp_path: Path) -> None:
    def asks_whether_it_is_open(context: StepContext) -> Outcome[Localization]:
        return Outcome(
            Localization(number=int(context.workcell.master.arm.observe().state is Lifecycle.DISCONNECTED))
        )

    recorded = Recorded(tmp_path, localization=asks_whether_it_is_open)
    recorded.cell.arm.state = Lifecycle.DISCONNECTED
    recorded.run("image")
    recorded.cell.journal.write(Entry.RESTARTED, 0.0)
    recorded.run("localization:T1")
    assert verdicts(recorded.replayed()) == {"image": EQUAL, "localization:T1": EQUAL}


@pytest.mark.hazard(2)
def test_a_replay_equals_a_run_killed_with_its_guide_in_front_of_an_entry(tmp_path: Path) -> None:
    def moves_with_the_guide(context: StepContext) -> Outcome[Localization]:
        context.workcell.master.mount.check(MountedTool.GUIDE)
        moves(context)
        return looks(context)

    def goes_in_or_out(context: StepContext) -> Outcome[Approach]:
        cell = context.workcell
        if not cell.master.place.is_on_axis:
            cell.master.insert(InsertionAxis("T1", cell.master.tool_pose(), 10.0))
            raise Killed
        cell.master.withdraw("T1")
        return Outcome(Approach(number=1))

    recorded = Recorded(tmp_path, localization=moves_with_the_guide, approach=goes_in_or_out)
    recorded.cell.arm.mounted = GUIDE
    recorded.run(*CASE[:4])
    with pytest.raises(Killed):
        recorded.run("approach:T1")
    restarted(recorded)
    recorded.engine.questions.request_instrument_removal()  # no line rules it out
    recorded.run("approach:T1")
    assert {one.verdict for one in recorded.replayed()} == {EQUAL}


@pytest.mark.hazard(2)
@pytest.mark.hazard(44)
def test_a_replay_equals_a_run_killed_with_an_instrument_in_its_guide(tmp_path: Path) -> None:
    def goes_in(context: StepContext) -> Outcome[Localization]:
        moves(context)  # refused while it is inside
        if not context.done_before:
            context.workcell.master.instrument.record_insertion("T1")
        return looks(context)

    recorded = Recorded(tmp_path, localization=goes_in)
    recorded.run(*CASE[:2])
    restarted(recorded)
    recorded.cell.workcell.master.instrument.record_assumed("T1")
    recorded.engine.questions.request_instrument_removal()
    recorded.run("localization:T1")
    assert {one.verdict for one in recorded.replayed()} == {EQUAL}


@pytest.mark.hazard(50)
def test_reads_by_a_precondition_do_not_consume_recorded_answers_of_its_step(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)

    def at_home(context: StepContext) -> tuple[str, ...]:
        return () if context.workcell.master.joints_rad() == HOME else ("the arm is not home",)

    image, localization, *others = recorded.order.steps
    order = replace(recorded.order, steps=(image, replace(localization, preconditions=at_home), *others))
    recorded.engine = recorded.cell.engine(order)
    recorded.engine.recorders = [recorded.tape]
    recorded.run(*CASE[:2])
    assert {one.verdict for one in recorded.replayed(order)} == {EQUAL}


@pytest.mark.hazard(44)
@pytest.mark.hazard(50)
def test_a_replay_permits_homing_when_a_guard_ended_the_step_before_the_instrument_went_in(
    tmp_path: Path,
) -> None:
    def goes_in(context: StepContext) -> Outcome[Approach]:
        outcome, first = moves(context), context.setting.memory.find(int) is None
        context.setting.memory.keep(1)
        context.progress(0.5, "before it goes in")
        if first:
            context.workcell.master.instrument.record_insertion("T1")
            raise GateFailed("it never came as far")
        return outcome

    class Suspends:
        name = "cart"

        def unmet(self) -> str | None:
            if recorded.cell.arm.motions:
                recorded.engine.checkpoint.guards.clear()
                raise GateFailed("the cart has moved")
            return None

    recorded = Recorded(tmp_path, approach=goes_in)
    recorded.cell.workcell.master.set_home()
    recorded.run(*CASE[:4])
    recorded.engine.checkpoint.guards.append(Suspends())
    recorded.run("approach:T1")
    recorded.engine.retreat_home()
    recorded.run("approach:T1")
    assert verdicts(recorded.replayed()) == dict.fromkeys(CASE[:5], EQUAL)


def test_an_edited_reading_shows_up_in_its_step_and_in_derived_results(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)
    recorded.run(*CASE)

    def turn(line: dict[str, Any]) -> None:
        if line["call"] == "read_state" and line["section"] < 5:
            line["answer"]["joints_rad"][0] += 0.001

    recorded.edit(turn)
    results = recorded.replayed()
    different = [result for result in results if result.verdict is DIFFERENT]
    assert [result.step for result in different] == ["localization:T1", "fit:T1"]
    assert different[0].why == ("number: 0 recorded, 1000 computed",)


def test_different_step_code_gives_different_results(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)
    recorded.run(*CASE[:3])

    def fits_otherwise(context: StepContext) -> Outcome[Fit]:
        return Outcome(Fit(number=context.result(Localization).number + 7))

    newer = plain_order("T1", localization=looks, fit=fits_otherwise)
    assert verdicts(recorded.replayed(newer))["fit:T1"] is DIFFERENT


def test_a_result_that_needs_missing_recordings_is_not_called_different(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)
    recorded.run(*CASE[:3])

    def forget(line: dict[str, Any]) -> None:
        line["section"] = 99

    recorded.edit(forget)
    found = verdicts(recorded.replayed())
    assert found == {"image": EQUAL, "localization:T1": NOT_RECORDED, "fit:T1": NOT_RECORDED}


def test_a_result_from_changed_recordings_is_called_changed(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)
    recorded.run(*CASE[:3])

    def spoil(line: dict[str, Any]) -> None:
        if line["call"] == "read_state":
            line["answer"]["joints_rad"] = "none"

    recorded.edit(spoil)
    changed = ReplayVerdict.CHANGED
    assert verdicts(recorded.replayed()) == {"image": EQUAL, "localization:T1": changed, "fit:T1": changed}


def test_changed_pixels_are_told_from_those_that_a_power_failure_has_cost(tmp_path: Path) -> None:
    folder = tmp_path / READINGS_FOLDER
    ReadingTape(folder, lambda: 1.0, {}).close()
    packed = pack_pixels(np.arange(600, dtype=np.uint8).reshape(20, 30))
    place = {PIXELS: {"at": 0, "bytes": len(packed), "shape": [20, 30], "type": "uint8"}}

    def load() -> object:
        return read_answers(tmp_path).value_of("stereo", "grab_pair", {"left": place}, StereoReading)

    (folder / PIXELS_FILE).write_bytes(packed[:-1] + bytes([packed[-1] ^ 1]))
    with pytest.raises(ReadingsChanged, match=r"PRO-024.*damaged.*verify lists"):
        load()
    (folder / PIXELS_FILE).write_bytes(packed[:-5])
    with pytest.raises(NotRecorded, match="damaged") as lost:
        load()
    assert not isinstance(lost.value, ReadingsChanged)


def test_a_step_that_failed_and_was_repeated_is_replayed_both_times(tmp_path: Path) -> None:
    def fails_at_first(context: StepContext) -> Outcome[Localization]:
        done = looks(context)
        if done.result.number == 0:
            raise GateFailed("stands at zero")
        return done

    recorded = Recorded(tmp_path, localization=fails_at_first)
    recorded.run("image", "localization:T1")
    A1, *others = recorded.cell.arm.joints_rad
    recorded.cell.arm.joints_rad = (A1 + 0.5, *others)  # type: ignore[assignment]
    recorded.run("localization:T1", "fit:T1")
    assert verdicts(recorded.replayed()) == dict.fromkeys(CASE[:3], EQUAL)


@pytest.mark.parametrize(
    ("turned_rad", "again"),
    [(0.0, "recomputed, with the same"), (0.001, "recomputed, it does not fail")],
)
def test_a_replay_says_how_a_step_without_a_result_failed_and_how_it_ends_again(
    tmp_path: Path, turned_rad: float, again: str
) -> None:
    def fails(context: StepContext) -> Outcome[Localization]:
        done = looks(context)
        if done.result.number == 0:
            raise GateFailed("stands at zero")
        return done

    recorded = Recorded(tmp_path, localization=fails)
    recorded.run("image", "localization:T1")

    def turn(line: dict[str, Any]) -> None:
        if line["call"] == "read_state":
            line["answer"]["joints_rad"][0] += turned_rad

    recorded.edit(turn)
    image, failed = recorded.replayed()
    assert image.verdict is EQUAL
    assert (failed.record, failed.step, failed.verdict) == ("", "localization:T1", ReplayVerdict.NO_RESULT)
    assert failed.why == (f"failed with PRO-007; {again}",)


def test_a_replay_opens_no_connection_and_does_not_change_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recorded = Recorded(tmp_path)
    recorded.run(*CASE)
    recorded.end()
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}

    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("a replay opened a link")

    monkeypatch.setattr(socket, "create_connection", refuse)
    monkeypatch.setattr(socket.socket, "bind", refuse)
    monkeypatch.setattr(socket.socket, "connect", refuse)
    assert verdicts(recorded.replayed()) == dict.fromkeys(CASE, EQUAL)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_the_operators_answers_come_from_the_journal(tmp_path: Path) -> None:
    def asks(context: StepContext) -> Outcome[Held]:
        context.result(Approach)
        word = context.choose(Question(Topic.AT_TARGET, "hold", "?", ("one", "two"), context.trajectory))
        return Outcome(Held(number={"one": 1, "two": 2}[word]))

    recorded = Recorded(tmp_path, held=asks)
    recorded.cell.operator.refusing = (Topic.AT_TARGET,)
    recorded.run(*CASE)
    assert verdicts(recorded.replayed())["held:T1"] is EQUAL


@pytest.mark.parametrize("kind", [RobotArm, ConfirmedStart, OpticalTracker, StereoPair])
def test_every_device_call_open_to_a_step_is_recorded_or_needs_no_recording(kind: type) -> None:
    asked = {name for name in dir(kind) if not name.startswith("_")}
    without_it = {"state", "fault", "observe", "active", "stop", "recover", "close"}
    assert asked - without_it - KNOWN_MEMBERS == set()


def test_damaged_or_missing_readings_are_refused(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)
    recorded.run("image")
    recorded.engine.close("left")
    path = tmp_path / READINGS_FOLDER / READINGS_FILE
    path.write_text('{"opening": {}}\nno json\n{"section": 1}\n')
    with pytest.raises(NotRecorded, match=r"line 2 of readings\.jsonl is not JSON"):
        read_answers(tmp_path)
    path.unlink()
    with pytest.raises(NotRecorded, match="PRO-024"):
        read_answers(tmp_path)


def pixels_at(**place: object) -> dict[str, object]:
    return {"answer": {PIXELS: {"at": 0, "bytes": 10, "shape": [1, 1], "type": "uint8", **place}}}


@pytest.mark.parametrize(
    "change",
    [
        {"section": []},
        {"theatre_time_s": None},
        {"state": "asleep"},
        {"properties": []},
        {"error": {"code": 5}},
        pixels_at(at=-1),
        pixels_at(at=2**63 - 1),
        pixels_at(bytes=10**14),
        pixels_at(bytes=-1),
        pixels_at(shape=[]),
        pixels_at(shape=[10**18, 10**18]),
    ],
    ids=repr,
)
def test_a_damaged_answer_is_refused(tmp_path: Path, change: dict[str, object]) -> None:
    folder = tmp_path / READINGS_FOLDER
    ReadingTape(folder, lambda: 1.0, {}).close()
    line = {"section": 1, "device": "stereo", "call": "grab_pair", "state": "active", "theatre_time_s": 1.0}
    with (folder / READINGS_FILE).open("a") as file:
        file.write(json.dumps(line | change) + "\n")
    with bounded_cost(), pytest.raises(NotRecorded, match="damaged"):
        [one.load() for one in iterate_readings(tmp_path)]


@pytest.mark.parametrize("opening", [5, {"series": 5}, {"began": "soon"}, {"calibration": []}], ids=repr)
def test_a_damaged_first_line_is_refused(tmp_path: Path, opening: object) -> None:
    (tmp_path / READINGS_FOLDER).mkdir()
    (tmp_path / READINGS_FOLDER / READINGS_FILE).write_text(json.dumps({"opening": opening}) + "\n")
    with pytest.raises(NotRecorded, match="line 1 of"):
        read_answers(tmp_path)


def test_a_line_torn_by_a_kill_is_skipped_when_the_run_was_continued(tmp_path: Path) -> None:
    recorded = Recorded(tmp_path)
    recorded.run(*CASE[:3])
    recorded.end()
    path = tmp_path / READINGS_FOLDER / READINGS_FILE
    with path.open("a") as file:
        file.write('{"section": 7, "dev')
    ReadingTape(tmp_path / READINGS_FOLDER, lambda: 1.0, {"paced": True}).close()
    assert verdicts(recorded.replayed()) == dict.fromkeys(CASE[:3], EQUAL)


def test_a_property_of_another_kind_is_not_given(tmp_path: Path) -> None:
    line = {"section": 1, "device": "robot", "call": "to_confirm", "state": "active", "theatre_time_s": 1.0}
    (tmp_path / READINGS_FOLDER).mkdir()
    lines = ({"opening": {}}, {**line, "answer": ["no text"]})
    (tmp_path / READINGS_FOLDER / READINGS_FILE).write_text("".join(f"{json.dumps(one)}\n" for one in lines))
    answers = read_answers(tmp_path)
    answers.begin(1)
    with pytest.raises(NotRecorded, match=r"PRO-024.*robot to to_confirm is damaged"):
        answers.look("robot", "to_confirm")


def test_the_first_motion_of_each_of_two_arms_is_asked_about_anew() -> None:
    operator = RecordedOperator()
    asked = {"entry": Entry.CONFIRMATION, "topic": str(Topic.FIRST_MOTION), "answer": "yes"}
    by_master, by_assistant = ({"entry": Entry.MOTION, "arm": arm} for arm in (MASTER, ASSISTANT))
    operator.begin([asked, by_master, asked, by_assistant])
    assert operator.find_first_to_move(0) == MASTER
    operator.ask(Question(Topic.FIRST_MOTION, "first motion", ""))
    assert operator.find_first_to_move(0) is None
    assert operator.find_first_to_move(1) == ASSISTANT


@pytest.mark.parametrize(
    ("answers", "recorded", "replayed"),
    [
        (("yes", "hold the guide"), "done", "yes"),
        (("yes", "hold the guide"), "hold", "hold the guide"),
        (("go on", "hold"), "hold", "hold"),
    ],
)
def test_a_run_from_before_an_answer_was_renamed_is_replayed_with_its_meaning(
    answers: tuple[str, ...], recorded: str, replayed: str
) -> None:
    operator = RecordedOperator()
    operator.begin([{"entry": Entry.CONFIRMATION, "topic": "skin:T1", "answer": recorded}])
    assert operator.ask(Question(Topic.SKIN, "Is it open?", "", answers, "T1")).word == replayed


def test_an_arm_is_computed_by_the_calibration_that_its_controller_had_stated(tmp_path: Path) -> None:
    with closing(HandmadeController()) as controller:
        controller.a = (0.0, -0.4253, *UR5E_A[2:])
        config = DeviceConfig(driver="universal_robots", endpoints=controller.endpoints)
        arm = UniversalRobotsArm("robot.master", config, HostClock())
        tape = ReadingTape(tmp_path / READINGS_FOLDER, lambda: 1.0, {"paced": True})
        tape.begin(1)
        with closing(tape_device(arm, tape)) as taped:
            taped.connect(5.0)
        tape.close()
    answers = read_answers(tmp_path)
    answers.begin(1)
    again = cast("RobotArm", make_stand_in(UniversalRobotsArm("robot.master", config, HostClock()), answers))
    nominal = again.kinematics.forward(STRETCHED_RAD)
    again.connect()
    assert again.kinematics.forward(STRETCHED_RAD) == arm.kinematics.forward(STRETCHED_RAD) != nominal
    assert again.kinematics is again.kinematics  # what is computed by it is kept
