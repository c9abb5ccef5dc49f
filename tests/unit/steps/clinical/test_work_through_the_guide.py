"""The depth stop is verified, then the instrument goes in by stages; nothing moves before it is out."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager
from typing import Any

import numpy as np
import pytest
from clinical_case import FIRST, ClinicalCell
from coded_errors import raises
from prepared_results import before_positioning, plan
from waiting import eventually
from watched_case import findings

from procedures.engine.engine import Engine
from procedures.engine.events import Advisory
from procedures.guards import GuideDisplacement, patient_watch
from procedures.guards.errors import BaseShifted, RoomUndecided
from procedures.guards.guide_displacement import LONGEST_GUIDE_UNSEEN_S, PUSHED_MM, GuideAtRest
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.operator.errors import GuardUnmet, NotConfirmed
from procedures.operator.question import Answer, Question, Topic
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.work_progress import STOP_LIMIT_MM
from procedures.steps.errors import DEPTH_STOP_WRONG, ReadingTooOld

READINGS = 10  # host time passes between them
LEVER_MM = 161.0  # from the frame on the mount to the lower end of the guide
TURN_RAD = math.radians(0.15)
UNDECIDED = r"PRO-052: the frame on the arm is not where the arm has it.*the guide is pushed or held"
STAGES = [Topic.SKIN, Topic.DRILL, Topic.DURA, Topic.AT_TARGET]


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("procedures.operator.checkpoint.PATIENCE_S", 0.0)
    monkeypatch.setattr("procedures.guards.guide_displacement.BETWEEN_LOOKS_S", 0.0)
    monkeypatch.setattr("procedures.guards.guide_displacement.PLACE_READINGS", READINGS // 2)
    monkeypatch.setattr("procedures.guards.guide_displacement.END_READINGS", READINGS)


def before_the_entry(cell: ClinicalCell) -> Engine:
    """An engine whose guide is held before the first entry."""
    engine = before_positioning(cell)
    setting = engine.setting
    engine.checkpoint.guards.append(GuideDisplacement(setting.workcell, setting.memory))
    engine.run_to(engine.order.find(f"positioning:{FIRST}"))
    cell.operator.asked.clear()
    return engine


def work(engine: Engine) -> None:
    engine.run_step(engine.order.find(f"at_target:{FIRST}"))


def instrument_lines(cell: ClinicalCell) -> list[object]:
    lines = read_journal(cell.folder / JOURNAL_FILE)
    return [line["inside"] for line in lines if line["entry"] == "instrument"]


@pytest.mark.hazard(44)
def test_every_stage_is_confirmed_and_the_instrument_is_out_at_the_end(cell: ClinicalCell) -> None:
    engine = before_the_entry(cell)
    work(engine)
    topics = [one.topic for one in cell.operator.asked]
    assert topics == [Topic.DEPTH_STOP, *STAGES, Topic.INSTRUMENT_OUT]
    done = [task.name for task in cell.room.worked]
    assert cell.room.worked[0].plausible_mm == (85.0, plan().instrument_length_mm)
    assert done == ["depth_stop", "skin", "drill", "dura", "insert", "out"]
    assert instrument_lines(cell) == [True, False]
    assert engine.instrument_in is None


def test_the_guide_is_looked_at_before_the_work_and_once_for_each_stage(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its reference, taken in the step before, is fresh, and the guide hides the head: ten seconds in all."""
    engine = before_the_entry(cell)
    monkeypatch.setattr("procedures.guards.guide_displacement.BETWEEN_LOOKS_S", 1.0)
    looks, look = [], GuideAtRest.look

    def counted(rest: GuideAtRest, *views: Any) -> None:
        looks.append(rest)
        look(rest, *views)

    monkeypatch.setattr(GuideAtRest, "look", counted)
    work(engine)
    assert len(looks) == 1 + len(STAGES)


@pytest.mark.hazard(45)
@pytest.mark.parametrize("off_mm", [0.08, -0.08])
def test_the_depth_stop_is_the_shown_sum_of_its_parts_and_its_deviation_is_part_of_the_error(
    cell: ClinicalCell, off_mm: float
) -> None:
    cell.room.stop_off_mm = off_mm
    work(before_the_entry(cell))
    reached = cell.case.get(ReachedTarget, FIRST).result
    depth_mm, computed_mm = plan().trajectory(FIRST).depth_mm, reached.depth_stop.computed_mm
    assert computed_mm == pytest.approx(85.0 + 30.0 + depth_mm)
    shown = f"bore 85.00 + stand-off 30.00 + depth {depth_mm:.2f} = {computed_mm:.2f} mm"
    assert shown in cell.operator.asked[0].value
    assert reached.too_deep_mm == pytest.approx(off_mm)
    assert reached.nominal_error_mm == pytest.approx(abs(off_mm), abs=1e-4)  # the arm is where it was sent


@pytest.mark.hazard(45)
@pytest.mark.branch("WRONG_STOP")
def test_no_instrument_goes_in_while_the_depth_stop_stays_wrong(cell: ClinicalCell) -> None:
    engine = before_the_entry(cell)
    cell.room.stop_off_mm = 1.1 * STOP_LIMIT_MM
    with raises(DEPTH_STOP_WRONG, match=r"TOOL-004: .*T1 is set wrong"):
        work(engine)
    assert [task.name for task in cell.room.worked] == ["depth_stop"] * 3
    assert instrument_lines(cell) == []


@pytest.mark.hazard(45)
@pytest.mark.branch("WRONG_STOP")
def test_a_corrected_depth_stop_is_confirmed(cell: ClinicalCell) -> None:
    engine = before_the_entry(cell)
    cell.room.stop_off_mm = -2 * STOP_LIMIT_MM
    cell.operator.asked.clear()
    cell.operator.meanwhile = lambda _question: setattr(cell.room, "stop_off_mm", 0.0)
    work(engine)
    asked = cell.operator.asked
    assert [one.topic for one in asked][:3] == [Topic.DEPTH_STOP, Topic.DEPTH_STOP, Topic.SKIN]
    assert "yes: set and read it again, attempt 2 of 3; no: the step ends" in asked[0].value


@pytest.mark.hazard(45)
def test_no_instrument_goes_in_by_a_depth_stop_read_too_long_ago(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = before_the_entry(cell)
    monkeypatch.setattr("procedures.steps.conditions.LONGEST_S", 0.0)
    with pytest.raises(ReadingTooOld, match="TOOL-007: the depth stop for T1: read too long ago"):
        work(engine)
    assert [task.name for task in cell.room.worked] == ["depth_stop", "skin", "drill", "dura"]
    monkeypatch.setattr("procedures.steps.conditions.LONGEST_S", 60.0)
    cell.room.worked.clear()
    cell.operator.answers[Topic.WORK_BEGUN] = "from insert"
    work(engine)
    assert [task.name for task in cell.room.worked] == ["out", "depth_stop", "insert", "out"]


def test_no_instrument_goes_in_without_a_depth_stop_reading(cell: ClinicalCell) -> None:
    engine = before_the_entry(cell)
    cell.room.work = lambda _task: ()  # type: ignore[method-assign]
    with pytest.raises(NotConfirmed, match="no readings were given"):
        work(engine)
    assert instrument_lines(cell) == []


@pytest.mark.hazard(44)
def test_interrupted_work_resumes_at_its_stage(cell: ClinicalCell) -> None:
    engine = before_the_entry(cell)
    cell.operator.refusing = (Topic.DRILL,)
    with pytest.raises(NotConfirmed, match="nobody confirmed at T1 that the skull is drilled"):
        work(engine)
    assert engine.instrument_in == FIRST
    cell.operator.refusing = ()
    cell.operator.asked.clear()
    work(engine)
    assert [one.topic for one in cell.operator.asked] == [*STAGES[1:], Topic.INSTRUMENT_OUT]


def led_there_again(cell: ClinicalCell) -> Engine:
    """The skin is open and the skull half drilled when the arm has to go home, and comes back."""
    engine = before_the_entry(cell)
    cell.operator.refusing = (Topic.DRILL,)
    with pytest.raises(NotConfirmed):
        work(engine)
    cell.operator.refusing = ()
    engine.retreat_home()
    engine.run_step(engine.order.find(f"positioning:{FIRST}"))
    cell.operator.asked.clear()
    return engine


@pytest.mark.hazard(44)
@pytest.mark.branch("WORK_BEGUN")
@pytest.mark.parametrize(("answer", "again"), [("from drill", STAGES[1:]), ("from skin", STAGES)])
def test_begun_work_is_shown_and_the_operator_chooses_the_stage_to_continue_from(
    cell: ClinicalCell, answer: str, again: list[Topic]
) -> None:
    engine = led_there_again(cell)
    cell.operator.answers = {Topic.WORK_BEGUN: answer}
    work(engine)
    asked = [one.topic for one in cell.operator.asked]
    assert asked == [Topic.WORK_BEGUN, Topic.DEPTH_STOP, *again, Topic.INSTRUMENT_OUT]
    begun, drill = (
        cell.operator.asked[0],
        next(one for one in cell.operator.asked if one.topic is Topic.DRILL),
    )
    assert begun.deliberate
    assert begun.answers == ("from drill", "from skin", "hold the guide")
    for question in (begun.subject, drill.value):
        assert "the skin is open, not yet confirmed: the skull is drilled" in question
    before = cell.case.get(ReachedTarget, FIRST).result.done_before
    assert before == (() if answer == "from skin" else ("skin",))


@pytest.mark.hazard(44)
@pytest.mark.branch("WORK_BEGUN")
def test_work_finished_before_its_result_was_written_is_not_repeated(cell: ClinicalCell) -> None:
    engine = before_the_entry(cell)
    store = engine.case.store
    engine.case.store = lambda *_: (_ for _ in ()).throw(OSError("no space"))  # type: ignore[method-assign]
    with pytest.raises(OSError, match="no space"):
        work(engine)
    engine.case.store = store  # type: ignore[method-assign]
    engine.retreat_home()
    engine.run_step(engine.order.find(f"positioning:{FIRST}"))
    cell.operator.asked.clear()
    worked = len(cell.room.worked)
    reader = engine.events.subscribe()
    work(engine)
    found = [one.what.text for one in reader.read(0.0).events if isinstance(one.what, Advisory)]
    assert [text for text in found if "not watched" in text]  # on the terminal and in the console
    (asked,) = cell.operator.asked
    assert asked.answers[0] == "finished"
    assert len(cell.room.worked) == worked
    reached = cell.case.get(ReachedTarget, FIRST).result
    assert reached.done_before == ("skin", "drill", "dura", "insert")
    assert reached.depth_stop.read_mm > 0.0
    assert (reached.tool_pose, reached.nominal_error_mm, reached.pushed_mm) == (None, None, None)


@pytest.mark.hazard(44)
@pytest.mark.branch("WORK_BEGUN")
def test_no_instrument_goes_in_unless_the_operator_chooses_the_stage(cell: ClinicalCell) -> None:
    engine = led_there_again(cell)
    cell.operator.refusing = (Topic.WORK_BEGUN,)
    lines = instrument_lines(cell)
    with pytest.raises(NotConfirmed, match="nobody chose the stage to continue from at T1"):
        work(engine)
    assert instrument_lines(cell) == lines


DISPLACED = {
    "pushed by little": ("frame_shift_mm", (0.6 * PUSHED_MM, 0.0, 0.0), 0.6 * PUSHED_MM),
    "pushed": ("frame_shift_mm", (1.5 * PUSHED_MM, 0.0, 0.0), 1.5 * PUSHED_MM),
    "its seat gives way": ("guide_shift_mm", (2.0 * PUSHED_MM, 0.0, 0.0), 2.0 * PUSHED_MM),
    "a turn of the wrist that leaves the frame in its place": ("frame_turn_rad", (0.0, TURN_RAD, 0.0), None),
}


@pytest.mark.hazard(46)
@pytest.mark.branch("GUIDE_PUSHED")
@pytest.mark.parametrize("how", DISPLACED)
def test_a_displaced_guide_suspends_the_case_until_it_is_released(cell: ClinicalCell, how: str) -> None:
    seen, displaced, expected_mm = DISPLACED[how]
    engine = before_the_entry(cell)
    if expected_mm is None:  # a turn shows where the frame on the guide is hidden
        cell.tracker.guide_shift_mm = None

    def displace(question: Question) -> None:
        setattr(cell.tracker, seen, displaced if question.topic is Topic.DRILL else (0.0, 0.0, 0.0))

    cell.operator.meanwhile = displace
    work(engine)
    pushed_mm = cell.case.get(ReachedTarget, FIRST).result.pushed_mm
    assert pushed_mm is not None
    if expected_mm is None:
        assert PUSHED_MM < pushed_mm <= LEVER_MM * TURN_RAD
    else:
        assert pushed_mm == pytest.approx(expected_mm)
    said = [one.subject for one in cell.operator.asked if one.topic is Topic.GUARD]
    assert len(said) == (pushed_mm > PUSHED_MM)
    for subject in said:
        assert f"pushed or pulled by {pushed_mm:.2f} mm" in subject
        assert "its seat has given way" in subject


def with_a_guide_pushed_at_the_skin(cell: ClinicalCell) -> Engine:
    """Return an engine before the entry; the guide is pushed there, and the operator refuses to go on."""
    engine = before_the_entry(cell)
    cell.operator.refusing = (Topic.GUARD,)

    def push(question: Question) -> None:
        if question.topic is Topic.SKIN:
            cell.tracker.frame_shift_mm = (2.0 * PUSHED_MM, 0.0, 0.0)

    cell.operator.meanwhile = push
    return engine


@pytest.mark.hazard(46)
@pytest.mark.branch("GUIDE_PUSHED")
def test_no_stage_begins_while_a_guide_that_suspended_the_step_is_still_displaced(cell: ClinicalCell) -> None:
    engine = with_a_guide_pushed_at_the_skin(cell)
    with pytest.raises(GuardUnmet, match="pushed or pulled"):
        work(engine)
    with pytest.raises(RoomUndecided, match=UNDECIDED):
        work(engine)
    assert [task.name for task in cell.room.worked] == ["depth_stop", "skin"]


@pytest.mark.hazard(46)
@pytest.mark.branch("WORK_BEGUN")
def test_a_question_about_interrupted_work_tells_what_interrupted_it(cell: ClinicalCell) -> None:
    engine = with_a_guide_pushed_at_the_skin(cell)
    with pytest.raises(GuardUnmet):
        work(engine)
    cell.tracker.frame_shift_mm = (0.0, 0.0, 0.0)
    cell.operator.refusing = ()
    engine.retreat_home()
    engine.run_step(engine.order.find(f"positioning:{FIRST}"))
    cell.operator.asked.clear()
    cell.operator.answers = {Topic.WORK_BEGUN: "from drill"}
    work(engine)
    asked = {one.topic: one for one in cell.operator.asked}
    for said in (asked[Topic.WORK_BEGUN].subject, asked[Topic.DRILL].value):
        assert f"the skin is open; interrupted: guide: pushed or pulled by {2.0 * PUSHED_MM:.2f} mm" in said
    assert "interrupted" not in asked[Topic.DURA].value  # the drilling was done meanwhile


@pytest.mark.hazard(46)
@pytest.mark.branch("GUIDE_PUSHED")
def test_a_seat_that_gave_way_and_is_then_hidden_does_not_count_as_repaired(cell: ClinicalCell) -> None:
    engine = before_the_entry(cell)

    def give_way_and_hide(question: Question) -> None:
        guards = [one for one in cell.operator.asked if one.topic is Topic.GUARD]
        gave_way = question.topic is Topic.DRILL
        cell.tracker.guide_shift_mm = None if len(guards) == 1 else (2.0 * PUSHED_MM * gave_way, 0.0, 0.0)

    cell.operator.meanwhile = give_way_and_hide
    work(engine)
    assert len([one for one in cell.operator.asked if one.topic is Topic.GUARD]) == 2


@pytest.mark.hazard(46)
@pytest.mark.branch("GUIDE_PUSHED")
@pytest.mark.parametrize(
    ("shift_mm", "turn_rad", "at_most_mm"), [(1.0, 0.0, 1.0), (0.0, TURN_RAD, LEVER_MM * TURN_RAD)]
)
def test_a_push_released_before_the_stage_is_confirmed_is_recorded_and_not_told_again(
    cell: ClinicalCell, shift_mm: float, turn_rad: float, at_most_mm: float
) -> None:
    engine = before_the_entry(cell)
    if turn_rad:  # shows where the frame on the guide is hidden
        cell.tracker.guide_shift_mm = None
    engine.checkpoint.watching = patient_watch(engine, lambda _moved: None).watching
    reader = engine.events.subscribe()

    def push(question: Question) -> None:
        pushed = question.topic is Topic.SKIN
        cell.tracker.frame_shift_mm = (shift_mm if pushed else 0.0, 0.0, 0.0)
        cell.tracker.frame_turn_rad = (0.0, turn_rad if pushed else 0.0, 0.0)
        read = cell.tracker.frames_read
        if question.topic in (Topic.SKIN, Topic.DRILL):
            eventually(lambda: cell.tracker.frames_read > read + READINGS)
        cell.tracker.frame_shift_mm = cell.tracker.frame_turn_rad = (0.0, 0.0, 0.0)

    cell.operator.meanwhile = push
    work(engine)
    # the readings of the watch are not replayed: no result is computed from them
    assert cell.case.get(ReachedTarget, FIRST).result.pushed_mm == pytest.approx(0.0, abs=1e-9)
    (found,) = (text for text in findings(cell) if text.endswith(f" mm during the hold at {FIRST}"))
    assert PUSHED_MM < float(found.removesuffix(f" mm during the hold at {FIRST}").split()[-1]) <= at_most_mm
    said = [one.what.text for one in reader.read(0.0).events if isinstance(one.what, Advisory)]
    assert len([text for text in said if "from where it was held" in text]) == 1


@pytest.mark.hazard(46)
@pytest.mark.branch("GUIDE_PUSHED")
def test_a_pushed_guide_that_is_then_hidden_from_the_tracker_does_not_count_as_released(
    cell: ClinicalCell,
) -> None:
    engine = before_the_entry(cell)

    def push_and_hide(question: Question) -> None:
        cell.tracker.frame_shift_mm = (1.5 * PUSHED_MM if question.topic is Topic.DRILL else 0.0, 0.0, 0.0)
        guards = [one for one in cell.operator.asked if one.topic is Topic.GUARD]
        cell.tracker.hidden = len(guards) == 1
        cell.tracker.guide_shift_mm = None  # nor the frame on the guide

    cell.operator.meanwhile = push_and_hide
    work(engine)
    said = [one.subject for one in cell.operator.asked if one.topic is Topic.GUARD]
    assert ["it is not seen now" in subject for subject in said] == [False, True]


@pytest.mark.hazard(46)
@pytest.mark.branch("GUIDE_PUSHED")
def test_a_push_that_only_the_frame_on_the_guide_shows_suspends_the_case(cell: ClinicalCell) -> None:
    engine = before_the_entry(cell)

    def push_behind_a_hand(question: Question) -> None:
        held = any(one.topic is Topic.GUARD for one in cell.operator.asked)
        cell.tracker.hidden = question.topic is Topic.DRILL
        cell.tracker.guide_shift_mm = (2.0 * PUSHED_MM * (cell.tracker.hidden and not held), 0.0, 0.0)

    cell.operator.meanwhile = push_behind_a_hand
    work(engine)
    assert len([one for one in cell.operator.asked if one.topic is Topic.GUARD]) == 1


@pytest.mark.hazard(46)
@pytest.mark.parametrize(
    ("hide", "named"),
    [
        ({"guide_shift_mm": None}, "the frame on the guide"),
        ({"hidden": True}, "the frame on the arm"),
        ({"spheres_mm": np.empty((0, 3))}, "the head"),
    ],
)
def test_what_the_tracker_does_not_see_while_somebody_works_is_named_with_its_time(
    cell: ClinicalCell, hide: dict[str, object], named: str
) -> None:
    engine = before_the_entry(cell)
    engine.checkpoint.watching = patient_watch(engine, lambda _moved: None).watching
    seen = {name: getattr(cell.tracker, name) for name in hide}

    def cover(question: Question) -> None:
        if question.topic is not Topic.AT_TARGET:
            return
        vars(cell.tracker).update(hide)
        read = cell.tracker.frames_read
        engine.setting.clock.sleep(2.0 * LONGEST_GUIDE_UNSEEN_S)
        eventually(lambda: cell.tracker.frames_read > read + READINGS)
        vars(cell.tracker).update(seen)

    cell.operator.meanwhile = cover
    work(engine)
    (found,) = (text for text in findings(cell) if "has gone back was not noticed" in text)
    assert f"the tracker did not see {named} for" in found


@pytest.mark.hazard(46)
@pytest.mark.parametrize("pushed_mm", [0.0, 1.5 * PUSHED_MM])
def test_a_stage_that_ends_with_the_guide_hidden_from_the_tracker_does_not_count_as_watched(
    cell: ClinicalCell, pushed_mm: float
) -> None:
    engine = before_the_entry(cell)

    def hide(question: Question) -> None:
        cell.tracker.hidden = question.topic is Topic.SKIN
        cell.tracker.guide_shift_mm = None if cell.tracker.hidden else (0.0, 0.0, 0.0)
        cell.tracker.frame_shift_mm = (pushed_mm if question.topic is Topic.DRILL else 0.0, 0.0, 0.0)

    cell.operator.meanwhile = hide
    work(engine)
    (found,) = (text for text in findings(cell) if "sees no frame on the arm or the guide" in text)
    assert f"at {FIRST}, the skin is open" in found
    reached = cell.case.get(ReachedTarget, FIRST).result
    assert reached.pushed_mm == (pytest.approx(pushed_mm) if pushed_mm else None)


@pytest.mark.branch("GUIDE_PUSHED")
@pytest.mark.parametrize(
    ("pushed_mm", "ends"),
    [
        pytest.param(
            0.5,
            pytest.raises(GuardUnmet, match=r"pushed or pulled by 0\.50 mm, limit 0\.2 mm: let go"),
            marks=pytest.mark.hazard(46),
            id="by a hand",
        ),
        pytest.param(
            12.0,
            pytest.raises(
                BaseShifted, match=r"the cart of the robot was moved, the frame on the arm by 12\.00 mm"
            ),
            marks=pytest.mark.hazard(13),
            id="with the cart",
        ),
    ],
)
def test_a_guide_that_stays_pushed_ends_the_step_and_leaves_the_instrument_in_place(
    cell: ClinicalCell, pushed_mm: float, ends: AbstractContextManager[object]
) -> None:
    engine = before_the_entry(cell)
    cell.operator.refusing = (Topic.GUARD,)
    ask = cell.operator.ask

    def push(question: Question) -> Answer:
        if question.topic is Topic.SKIN:
            cell.tracker.frame_shift_mm = (0.0, 0.0, pushed_mm)
        return ask(question)

    cell.operator.ask = push  # type: ignore[method-assign]
    with ends:
        work(engine)
    assert engine.instrument_in == FIRST
    assert list(cell.workcell.master.instrument.stages.tasks_at(FIRST).values()) == [
        True
    ]  # what was confirmed is done


@pytest.mark.hazard(44)
def test_a_guard_that_fails_after_the_instrument_is_out_does_not_undo_the_work(cell: ClinicalCell) -> None:
    engine = before_the_entry(cell)

    class Moves:
        name = "cart"

        def unmet(self) -> str | None:
            if Topic.INSTRUMENT_OUT in [one.topic for one in cell.operator.asked]:
                raise BaseShifted("the cart has moved")
            return None

    engine.checkpoint.guards.append(Moves())
    work(engine)
    assert engine.case.stands(engine.order.find(f"at_target:{FIRST}"))


@pytest.mark.hazard(44)
def test_a_stage_confirmed_before_the_step_ended_is_not_asked_for_again(cell: ClinicalCell) -> None:
    engine = before_the_entry(cell)

    class Suspends:
        name = "cart"

        def unmet(self) -> str | None:
            if [one.topic for one in cell.operator.asked][-1:] == [Topic.DRILL]:
                raise GuardUnmet("somebody leaves the step")
            return None

    engine.checkpoint.guards.append(Suspends())
    with pytest.raises(GuardUnmet):
        work(engine)
    engine.checkpoint.guards.pop()
    cell.operator.asked.clear()
    work(engine)
    assert [one.topic for one in cell.operator.asked] == [*STAGES[2:], Topic.INSTRUMENT_OUT]
