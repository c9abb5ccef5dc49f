"""Hazard 12: every sphere is covered while a guide approaches the head or is in it; the time is bounded."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from clinical_case import FIRST, SPHERES_MM, ClinicalCell
from waiting import eventually
from watched_case import findings, on_the_way, positioned, voiding, watched

from procedures.engine.engine import Engine
from procedures.engine.events import Advisory
from procedures.guards import HeadInSight
from procedures.guards.errors import PatientMoved
from procedures.operator.errors import GuardUnmet
from procedures.operator.question import Answer, Question, Topic
from ronna_hw.devices.readings import Validity
from ronna_hw.errors import DeviceError

pytestmark = [pytest.mark.hazard(12), pytest.mark.branch("HEAD_UNSEEN")]

UNSEEN_S = 0.2
NOTHING_MM = SPHERES_MM[:0]


@pytest.fixture(autouse=True)
def soon(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("procedures.guards.head_sight.MOST_UNSEEN_S", UNSEEN_S)
    monkeypatch.setattr("procedures.guards.tracker_guards.PATIENCE_S", 0.0)


def guarded(cell: ClinicalCell) -> Engine:
    engine = watched(cell)
    workcell, memory = engine.setting.workcell, engine.setting.memory
    engine.checkpoint.guards.append(HeadInSight(workcell, memory, voiding(engine), engine.find))
    return engine


def answering(cell: ClinicalCell, answer: str, meanwhile: Callable[[], None] = lambda: None) -> None:
    """The operator answers the question about the unseen head."""
    otherwise = cell.operator.ask

    def ask(question: Question) -> Answer:
        first = otherwise(question)
        if question.topic is not Topic.HEAD_UNSEEN:
            return first
        meanwhile()
        return Answer(answer)

    cell.operator.ask = ask  # type: ignore[method-assign]


def covered(cell: ClinicalCell) -> Callable[[], None]:
    """All spheres are covered, and the motion goes on until somebody stops it."""

    def cover() -> None:
        cell.tracker.spheres_mm = NOTHING_MM
        eventually(lambda: cell.arm.stops > 0)
        cell.arm.interruptions = 1

    return cover


def test_a_head_covered_during_a_motion_stops_the_arm_and_suspends_the_case(cell: ClinicalCell) -> None:
    engine = guarded(cell)
    answering(cell, "leave")
    on_the_way(cell, covered(cell))
    with pytest.raises(GuardUnmet, match=r"PRO-017.*has not seen the head for \d+ s"):
        positioned(engine)
    assert cell.arm.motions == []
    assert ("rested", "") in cell.entries("rested")
    assert engine.machine.state == "held"
    engine.retreat_home()  # the way out is not held up
    assert cell.workcell.master.place.is_home


def test_the_operator_may_continue_without_sight_and_the_motion_is_confirmed_again(
    cell: ClinicalCell,
) -> None:
    engine = guarded(cell)
    answering(cell, "continue")
    on_the_way(cell, covered(cell))
    positioned(engine)
    asked = [question.topic for question in cell.operator.asked]
    assert Topic.PAUSE not in asked
    assert asked[asked.index(Topic.HEAD_UNSEEN) + 1] is Topic.FIRST_MOTION


def test_a_long_pending_question_does_not_stop_the_motion_that_follows(cell: ClinicalCell) -> None:
    engine = guarded(cell)

    def show() -> None:
        cell.tracker.spheres_mm = SPHERES_MM

    answering(cell, "wait", show)
    ask = cell.operator.ask

    def take_time(question: Question) -> Answer:
        if question.topic is Topic.FIRST_MOTION:
            time.sleep(2.0 * UNSEEN_S)  # nothing else passes meanwhile
        return ask(question)

    cell.operator.ask = take_time  # type: ignore[method-assign]
    on_the_way(cell, covered(cell))
    positioned(engine)
    assert cell.arm.stops == 1  # for the covered head


def test_a_head_that_moved_while_covered_is_detected_when_it_is_visible_again(cell: ClinicalCell) -> None:
    engine = guarded(cell)

    def show() -> None:
        cell.tracker.spheres_mm = np.add(SPHERES_MM, (0.0, 0.5, 0.0))

    answering(cell, "wait", show)
    on_the_way(cell, covered(cell))
    with pytest.raises(PatientMoved):
        positioned(engine)
    assert cell.arm.motions == []
    assert cell.entries("voided") == [("voided", "registration")]  # which may follow


def test_work_at_an_unwatched_target_needs_consent(cell: ClinicalCell) -> None:
    engine = guarded(cell)
    positioned(engine)
    answer = cell.operator.ask
    shown: list[str] = []
    reader = engine.events.subscribe()

    def cover_and_answer(question: Question) -> Answer:
        if question.topic is Topic.AT_TARGET:
            before = cell.arm.stops  # it stands in hold
            cell.tracker.spheres_mm = NOTHING_MM
            eventually(lambda: any("too long" in str(one.what) for one in reader.read(0.1).events))
            shown.append(f"at once, after {cell.arm.stops - before} stops")
        return Answer("leave") if question.topic is Topic.HEAD_UNSEEN else answer(question)

    cell.operator.ask = cover_and_answer  # type: ignore[method-assign]
    with pytest.raises(GuardUnmet, match="PRO-017"):
        engine.run_step(engine.order.find(f"at_target:{FIRST}"))
    assert shown == ["at once, after 0 stops"]  # it rests already
    assert engine.instrument_in == FIRST


def test_the_unseen_time_also_counts_when_the_tracker_fails_during_a_motion(cell: ClinicalCell) -> None:
    engine = guarded(cell)
    answering(cell, "leave")
    read = cell.tracker.read_frame

    def fail(_timeout_s: float = 1.0) -> None:
        cell.tracker.read_frame = read  # type: ignore[method-assign]
        raise DeviceError("it is too hot")

    def break_it() -> None:
        cell.tracker.read_frame = fail  # type: ignore[assignment,method-assign]
        covered(cell)()

    on_the_way(cell, break_it)
    with pytest.raises(GuardUnmet):
        positioned(engine)
    assert any("the head was not watched" in text for text in findings(cell))


def test_a_tracker_that_repeats_its_last_frame_does_not_see_the_head(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("procedures.guards.watch_thread.REPEATING_S", UNSEEN_S / 2)
    engine = guarded(cell)
    answering(cell, "leave")
    reader = engine.events.subscribe()

    def repeat() -> None:
        last = replace(cell.tracker.read_frame(), validity=Validity.STALE)
        with monkeypatch.context() as repeating:
            repeating.setattr(cell.tracker, "read_frame", lambda _timeout_s=1.0: last)
            covered(cell)()

    on_the_way(cell, repeat)
    with pytest.raises(GuardUnmet):
        positioned(engine)
    said = [one.what.text for one in reader.read(0.1).events if isinstance(one.what, Advisory)]
    assert "the head is not watched: the tracker repeats its last frame" in said
