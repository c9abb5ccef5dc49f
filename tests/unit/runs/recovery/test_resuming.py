"""A case is resumed in this order and no other: compare, accept, move."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import pytest
from clinical_case import FIRST, ClinicalCell
from coded_errors import raises
from left_operation import case_order, left_after, left_with_an_instrument_inside
from recording_cell import GUIDE
from run_again import broken_off, lose_lines, opened_again

from procedures.engine import questions
from procedures.engine.engine import Engine
from procedures.engine.errors import RECOVERY_REFUSED
from procedures.engine.order import order_of
from procedures.journal.errors import StepRefused
from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Topic
from procedures.runs.interrupted_run import InterruptedRun, read_interrupted_run
from procedures.runs.recovery import bring_home, recover
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.results import Relocalization
from ronna_hw.arm.errors import NotClear
from ronna_hw.arm.pose import radians6
from ronna_hw.devices.capabilities import Fact


@pytest.mark.hazard(2)
def test_nothing_moves_before_the_findings_are_accepted(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, "tool_change")
    again.operator.refusing = (Topic.RESUME,)
    with raises(RECOVERY_REFUSED, match="PRO-032"):
        recover(engine, left)
    assert again.arm.motions == []
    assert "activate" not in again.arm.calls
    assert again.entries("found", "accepted") == [("found", "")]


@pytest.mark.hazard(2)
def test_an_acceptance_that_times_out_is_reported_with_its_time_limit(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    again, engine, left = left_after(cell, "tool_change")
    again.operator.refusing = (Topic.RESUME,)
    monkeypatch.setattr(questions, "monotonic", itertools.count(0.0, 300.0).__next__)
    with raises(RECOVERY_REFUSED, match=r"PRO-032: the time to answer ran out; .*limit 300 s"):
        recover(engine, left)


def test_a_pending_controller_message_is_reported_with_its_full_command_before_any_question(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    again, engine, left = left_after(cell, "positioning:T1")
    message = Fact("messages", "29002 is not acknowledged", ready=False, advice="Remove its cause.")
    seen = replace(again.arm.observe(), says=(message,))
    monkeypatch.setattr(again.arm, "observe", lambda: seen)
    with pytest.raises(StepRefused, match="arm, messages: 29002 is not acknowledged") as refused:
        recover(engine, left)
    assert f"ronna-procedure acknowledge {again.folder} --by 'YOUR NAME'" in refused.value.advice
    assert again.operator.asked == []


@pytest.mark.hazard(2)
def test_dangerous_findings_come_first_on_a_line_each_and_unchanged_items_share_one_line(
    cell: ClinicalCell,
) -> None:
    again, engine, left = left_after(cell, "positioning:T1")
    recover(engine, left)
    first, *_others, last = again.operator.asked[0].value.split("\n")
    assert first == "the journal does not rule out an instrument in T1: one is assumed to be inside"
    assert last.endswith(" items as recorded")
    found, *_ = (line for line in read_journal(again.folder / JOURNAL_FILE) if line["entry"] == Entry.FOUND)
    assert "plan: as recorded" in found["findings"] or "the guide: as recorded" in found["findings"]


@pytest.mark.hazard(2)
def test_registrations_older_than_a_fault_of_the_arm_are_named_before_the_run_goes_on(
    cell: ClinicalCell,
) -> None:
    again, engine, left = left_after(cell, "tool_change")
    engine.case.doubt(next(iter(engine.order.localizations)), "EKI-010: emergency stop")
    recover(engine, left)
    first, *_ = again.operator.asked[0].value.split("\n")
    assert first.startswith("EKI-010: emergency stop came after ")
    assert first.endswith("whether they are kept is asked before they are used")


@pytest.mark.hazard(2)
def test_a_case_with_the_guide_away_from_the_head_resumes_with_its_next_step(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, "tool_change")
    recover(engine, left)
    assert again.arm.motions == []  # it was home
    engine.run_to()
    entries = [kind for kind, _ in again.entries()]
    assert entries.index(Entry.ACCEPTED) < entries.index(Entry.MOTION)


@pytest.mark.hazard(2)
def test_a_guide_in_front_of_an_entry_is_withdrawn_before_anything_else(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, f"positioning:{FIRST}")
    before = len(again.motions("withdraw"))
    recover(engine, left)
    assert len(again.motions("withdraw")) == before + 1
    assert again.workcell.master.place.is_home
    assert str(engine.upcoming) == f"positioning:{FIRST}"  # the work at the target was not done
    engine.run_to()


@pytest.mark.hazard(2)
@pytest.mark.parametrize("lost_from", [b'"what":"insert"', b'"step":"tool_change"'])
def test_a_guide_whose_journal_lines_were_lost_is_found_by_its_position(
    cell: ClinicalCell, lost_from: bytes
) -> None:
    order = case_order(cell)
    cell.engine(order).run_to(order.find(f"positioning:{FIRST}"))
    broken_off(cell)
    path = cell.folder / JOURNAL_FILE
    lines = path.read_bytes().splitlines(keepends=True)
    lost = next(number for number, line in enumerate(lines) if lost_from in line)
    path.write_bytes(b"".join(lines[:lost]) + bytes(sum(map(len, lines[lost:]))))
    again, engine, left = opened_again(cell, order)
    recover(engine, left)
    assert len(again.motions("withdraw")) == 1
    assert again.workcell.master.place.is_home
    # the lost lines can have said that an instrument goes in
    assert [one.topic for one in again.operator.asked][1] is Topic.INSTRUMENT_OUT
    assert not left.run.lines(Entry.RESTARTED)
    again.journal.write(Entry.RESTARTED, 0.0, **left.as_plain())
    assert read_interrupted_run(again.folder).ever_lost_lines  # also to the next program


@pytest.mark.hazard(44)
@pytest.mark.parametrize("way", [recover, bring_home])
@pytest.mark.parametrize("torn", [False, True])
def test_an_instrument_whose_journal_line_was_lost_counts_as_inside(
    cell: ClinicalCell, way: Callable[[Engine, InterruptedRun], object], torn: bool
) -> None:
    order = case_order(cell)
    cell.engine(order).run_to(order.find(f"at_target:{FIRST}"))
    broken_off(cell)
    path = cell.folder / JOURNAL_FILE
    lines = path.read_bytes().splitlines(keepends=True)
    goes_in = next(number for number, line in enumerate(lines) if b'"inside":true' in line)
    path.write_bytes(b"".join(lines[:goes_in]) + (bytes(len(lines[goes_in])) if torn else b""))
    again, engine, left = opened_again(cell, order)
    again.operator.refusing = (Topic.INSTRUMENT_OUT,)
    with pytest.raises(NotConfirmed, match="still in T1: nothing moves"):
        way(engine, left)
    assert again.arm.motions == []


@pytest.mark.hazard(44)
@pytest.mark.branch("INSTRUMENT_INSIDE")
@pytest.mark.parametrize("way", [recover, bring_home])
@pytest.mark.parametrize("inside", [True, False])
def test_a_guide_at_the_gauge_counts_as_holding_the_mandrel_until_confirmed_out(
    cell: ClinicalCell, way: Callable[[Engine, InterruptedRun], object], inside: bool
) -> None:
    order = case_order(cell)
    cell.engine(order).run_to(order.find("tool_change"))
    broken_off(cell)  # and the line that the mandrel goes in is lost
    beside_rad = 0.0 if inside else math.radians(2.0)
    A1, *others = map(math.radians, cell.workcell.tools.guide.gauge.joints_deg)
    cell.arm.joints_rad = radians6(*map(math.degrees, (A1 + beside_rad, *others)))
    again, engine, left = opened_again(cell, order)
    again.operator.refusing = (Topic.INSTRUMENT_OUT,)
    if not inside:
        way(engine, left)
        assert again.workcell.master.place.is_home
        return
    with pytest.raises(NotConfirmed, match="still in the gauge: nothing moves"):
        way(engine, left)
    assert again.arm.motions == []


@pytest.mark.hazard(44)
@pytest.mark.branch("INSTRUMENT_INSIDE")
@pytest.mark.branch("WORK_BEGUN")
def test_after_a_kill_during_the_insertion_instrument_and_begun_work_are_asked_about(
    cell: ClinicalCell,
) -> None:
    again, engine, left = left_with_an_instrument_inside(cell, case_order(cell))
    recover(engine, left)
    topics = [one.topic for one in again.operator.asked]
    assert topics[:2] == [Topic.RESUME, Topic.INSTRUMENT_OUT]
    assert again.workcell.master.place.is_home
    assert str(engine.upcoming) == f"positioning:{FIRST}"
    assert "work has begun at T1: the skin is open, the skull is drilled" in again.operator.asked[0].value
    engine.run_to()
    (asked,) = [one for one in again.operator.asked if one.topic is Topic.WORK_BEGUN]
    assert asked.answers[0] == "from dura"
    assert "the skin is open, the skull is drilled, not yet confirmed: the dura is open" in asked.subject
    assert again.case.get(ReachedTarget, FIRST).result.done_before == ("skin", "drill")


@pytest.mark.hazard(44)
@pytest.mark.branch("WORK_BEGUN")
def test_work_of_which_the_journal_has_lost_every_line_is_asked_about(cell: ClinicalCell) -> None:
    order = case_order(cell)
    cell.engine(order).run_to(order.find(f"positioning:{FIRST}"))
    broken_off(cell)
    again, engine, left = opened_again(cell, order)
    recover(engine, left)
    assert "work may have begun at T1: more may have been done" in again.operator.asked[0].value
    again.operator.answers[Topic.WORK_BEGUN] = "from dura"
    engine.run_to()
    (asked,) = [one for one in again.operator.asked if one.topic is Topic.WORK_BEGUN]
    assert asked.answers == ("from skin", "from drill", "from dura", "from insert", "hold the guide")
    assert again.case.get(ReachedTarget, FIRST).result.done_before == ("skin", "drill")


@pytest.mark.hazard(44)
def test_a_record_without_a_line_of_a_target_reached_puts_the_work_there_in_doubt(cell: ClinicalCell) -> None:
    order = case_order(cell)
    cell.engine(order).run_to(order.find("tool_change"))
    cell.case.store(order.find(f"retreat:{FIRST}"), cell.case.get(Relocalization, FIRST).result, ())
    broken_off(cell)
    again, engine, left = opened_again(cell, order)
    recover(engine, left)
    (orphan,) = left.orphans
    for said in (
        f"records that the journal does not name, not used: {orphan}",
        "work has begun at T1: the skin is open, the skull is drilled, the dura is open",
    ):
        assert said in again.operator.asked[0].value


@pytest.mark.hazard(44)
@pytest.mark.branch("WORK_BEGUN")
def test_work_in_lines_that_only_the_event_file_still_has_is_named_asked_about_and_not_repeated(
    cell: ClinicalCell,
) -> None:
    order = case_order(cell)
    left_with_an_instrument_inside(cell, order)
    lose_lines(cell.folder, from_line_with=b'"task":"depth_stop"')
    again, engine, left = opened_again(cell, order)
    recover(engine, left)
    found = again.operator.asked[0].value
    assert "the journal has lost its end: events.jsonl has" in found
    assert "work at T1 (skin, drill, dura)" in found
    engine.run_to()
    (asked,) = [one for one in again.operator.asked if one.topic is Topic.WORK_BEGUN]
    assert asked.answers == ("from dura", "from drill", "from skin", "from insert", "hold the guide")
    assert again.case.get(ReachedTarget, FIRST).result.done_before == ("skin", "drill")


@pytest.mark.hazard(44)
@pytest.mark.branch("INSTRUMENT_INSIDE")
@pytest.mark.parametrize("way", [recover, bring_home])
def test_nothing_moves_after_a_kill_during_the_insertion_while_the_instrument_is_inside(
    cell: ClinicalCell, way: Callable[[Engine, InterruptedRun], object]
) -> None:
    again, engine, left = left_with_an_instrument_inside(cell, case_order(cell))
    again.operator.refusing = (Topic.INSTRUMENT_OUT,)
    with pytest.raises(NotConfirmed, match="still in T1: nothing moves"):
        way(engine, left)
    assert again.arm.motions == []
    assert again.operator.asked[0].value.split("\n")[0] == "an instrument is in T1, as the journal says"


def test_only_the_retreat_and_the_look_remain_after_the_work_at_the_target(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, f"at_target:{FIRST}")
    recover(engine, left)
    assert str(engine.upcoming) == f"confirmation:{FIRST}"
    engine.run_to()
    assert engine.over
    assert len(again.motions("insert")) == 1
    assert len(again.motions("withdraw")) == 1


def test_a_retreat_killed_outside_the_entry_is_finished_from_there(cell: ClinicalCell) -> None:
    order = case_order(cell)
    engine = cell.engine(order)
    engine.run_to(order.find(f"at_target:{FIRST}"))
    cell.arm.blocked = lambda _start, _target: True  # the way home
    with pytest.raises(NotClear):
        engine.run_step(order.find(f"retreat:{FIRST}"))
    broken_off(cell)
    again, engine, left = opened_again(cell, order)
    recover(engine, left)
    assert again.workcell.master.place.is_home
    engine.run_to()
    assert engine.upcoming is None
    assert len(again.motions("withdraw")) == 1


def test_a_tool_change_killed_midway_may_already_have_been_done(cell: ClinicalCell) -> None:
    def killed(_context: object) -> None:
        raise MemoryError

    order = case_order(cell)
    steps = [replace(step, run=killed) if step.name == "tool_change" else step for step in order.steps]
    order = order_of(steps, order.trajectories)
    with pytest.raises(MemoryError):
        cell.engine(order).run_to()
    broken_off(cell)
    again, engine, left = opened_again(cell, order)
    assert again.arm.mounted == GUIDE
    recover(engine, left)
    assert str(engine.upcoming) == "tool_change"
