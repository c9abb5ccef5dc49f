"""A case is taken up again: compared, accepted, then moved, in this order and in no other."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from clinical_case import FIRST, ClinicalCell, given
from prepared_results import (
    checked_paths,
    checked_plan,
    checked_set_up,
    checked_tool,
    correspondence,
    global_localization,
    localized_fiducials,
    mounted_guide,
    registered_robot,
    relocalization,
)
from recording_cell import GUIDE, STEREO_HEAD
from run_again import broken_off, opened_again

from procedures.engine.engine import Engine
from procedures.engine.errors import RecoveryRefused
from procedures.engine.left_run import LeftRun
from procedures.engine.order import CaseOrder, order_of
from procedures.engine.step import Scope, StepSpec
from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Question
from procedures.operator.topic import Topic
from procedures.recovery import bring_home, inputs, recover, taking_up
from procedures.results.errors import StepRefused
from procedures.results.result import StepResult
from procedures.steps.clinical import at_target, positioning, retreat
from procedures.steps.clinical.at_target import ReachedTarget
from procedures.steps.clinical.set_up import DeviceIdentity
from procedures.workcell import MountedTool
from ronna_hw.arm.angles import radians6
from ronna_hw.arm.errors import NotClear
from ronna_hw.calibration import CalibrationExpired, DatedRecord
from ronna_hw.config import Calibrations
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.devices.readiness import Fact
from ronna_hw.errors import LinkTimeout
from ronna_hw.evidence.inspection import Problem


def per_trajectory(result: StepResult) -> StepSpec[StepResult]:
    return replace(given(result), scope=Scope.LOCALIZATION)


def case_order(cell: ClinicalCell) -> CaseOrder:
    """The operation of a case, with everything before it given."""
    set_up = checked_set_up(cell).model_copy(
        update={
            "identities": {
                role: DeviceIdentity.of(Identity("Test", f"a {role}", "1", "0"))
                for role in ("tracker", "arm", "stereo")
            }
        }
    )
    before = [
        given(one)
        for one in (localized_fiducials(), checked_plan(), set_up, global_localization(), correspondence())
    ]
    localized = [per_trajectory(one) for one in (relocalization(), registered_robot())]
    steps = [*before, given(checked_paths(cell)), *localized, given(mounted_guide()), given(checked_tool())]
    return order_of([*steps, positioning.STEP, at_target.STEP, retreat.STEP], [FIRST])


@pytest.fixture(autouse=True)
def no_room_to_look_at(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tracker has its own tests; here every look at the room sees what was recorded."""
    monkeypatch.setattr(taking_up, "compare_room", lambda _engine, _comparison: True)
    for step in (positioning, retreat):
        monkeypatch.setattr(step, "check_room", lambda _context, _where: None, raising=False)


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path / "run").carrying(MountedTool.GUIDE)


def left_after(cell: ClinicalCell, last: str) -> tuple[ClinicalCell, Engine, LeftRun]:
    order = case_order(cell)
    cell.engine(order).run_to(order.find(last))
    broken_off(cell)
    return opened_again(cell, order)


@pytest.mark.hazard(2)
def test_nothing_moves_before_what_was_found_is_accepted(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, "tool_change")
    again.operator.refusing = (Topic.RESUME,)
    with pytest.raises(RecoveryRefused, match="PRO-032"):
        recover(engine, left)
    assert again.arm.motions == []
    assert "activate" not in again.arm.calls
    assert again.entries("found", "accepted") == [("found", "")]


def test_what_the_controller_holds_back_is_said_before_anything_is_asked_with_the_whole_command(
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
def test_what_can_hurt_is_read_first_one_to_a_line_and_what_is_as_it_was_is_one_line(
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
def test_a_case_whose_guide_is_away_goes_on_with_its_next_step(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, "tool_change")
    recover(engine, left)
    assert again.arm.motions == []  # it was home
    engine.run_to()
    entries = [kind for kind, _ in again.entries()]
    assert entries.index(Entry.ACCEPTED) < entries.index(Entry.MOTION)


@pytest.mark.hazard(2)
def test_a_guide_before_an_entry_comes_back_before_anything_else(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, f"positioning:{FIRST}")
    before = len(again.motions("withdraw"))
    recover(engine, left)
    assert len(again.motions("withdraw")) == before + 1
    assert again.workcell.at_home
    assert str(engine.upcoming) == f"positioning:{FIRST}"  # the work at the target was not done
    engine.run_to()


@pytest.mark.hazard(2)
@pytest.mark.parametrize("lost_from", [b'"what":"insert"', b'"step":"tool_change"'])
def test_a_guide_whose_lines_were_lost_is_found_by_where_it_is(cell: ClinicalCell, lost_from: bytes) -> None:
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
    assert again.workcell.at_home
    # the lost lines can have said that an instrument goes in
    assert [one.topic for one in again.operator.asked][1] is Topic.INSTRUMENT_OUT


@pytest.mark.hazard(44)
@pytest.mark.parametrize("way", [recover, bring_home])
@pytest.mark.parametrize("torn", [False, True])
def test_where_only_the_line_of_the_instrument_was_lost_it_counts_as_inside(
    cell: ClinicalCell, way: Callable[[Engine, LeftRun], object], torn: bool
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
def test_a_guide_at_the_gauge_holds_the_mandrel_until_it_is_said_to_be_out(
    cell: ClinicalCell, way: Callable[[Engine, LeftRun], object], inside: bool
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
        assert again.workcell.at_home
        return
    with pytest.raises(NotConfirmed, match="still in the gauge: nothing moves"):
        way(engine, left)
    assert again.arm.motions == []


def left_with_an_instrument_inside(cell: ClinicalCell) -> tuple[ClinicalCell, Engine, LeftRun]:
    """Killed while somebody works through the guide."""
    order, ask = case_order(cell), cell.operator.ask

    def killed(question: Question) -> str:
        if question.topic is Topic.DURA:
            raise MemoryError
        return ask(question)

    cell.operator.ask = killed  # type: ignore[method-assign]
    with pytest.raises(MemoryError):
        cell.engine(order).run_to()
    broken_off(cell)
    return opened_again(cell, order)


@pytest.mark.hazard(44)
@pytest.mark.branch("INSTRUMENT_INSIDE")
def test_after_a_kill_during_the_insertion_it_is_asked_whether_the_instrument_is_out(
    cell: ClinicalCell,
) -> None:
    again, engine, left = left_with_an_instrument_inside(cell)
    recover(engine, left)
    topics = [one.topic for one in again.operator.asked]
    assert topics[:3] == [Topic.RESUME, Topic.INSTRUMENT_OUT, Topic.FIRST_MOTION] or topics[1] is (
        Topic.INSTRUMENT_OUT
    )
    assert again.workcell.at_home
    assert str(engine.upcoming) == f"positioning:{FIRST}"


@pytest.mark.hazard(44)
@pytest.mark.branch("WORK_BEGUN")
def test_what_hands_had_done_before_a_kill_is_asked_about_when_the_guide_is_there_again(
    cell: ClinicalCell,
) -> None:
    again, engine, left = left_with_an_instrument_inside(cell)
    recover(engine, left)
    assert "work has begun at T1: the skin is open, the skull is drilled" in again.operator.asked[0].value
    engine.run_to()
    (asked,) = [one for one in again.operator.asked if one.topic is Topic.WORK_BEGUN]
    assert asked.answers[0] == "from dura"
    assert "the skin is open, the skull is drilled, begun and not confirmed: open the dura" in asked.subject
    assert again.case.get(ReachedTarget, FIRST).result.done_before == ("skin", "drill")


@pytest.mark.hazard(44)
@pytest.mark.branch("INSTRUMENT_INSIDE")
@pytest.mark.parametrize("way", [recover, bring_home])
def test_after_a_kill_during_the_insertion_nothing_moves_while_the_instrument_is_inside(
    cell: ClinicalCell, way: Callable[[Engine, LeftRun], object]
) -> None:
    again, engine, left = left_with_an_instrument_inside(cell)
    again.operator.refusing = (Topic.INSTRUMENT_OUT,)
    with pytest.raises(NotConfirmed, match="still in T1: nothing moves"):
        way(engine, left)
    assert again.arm.motions == []


def test_after_the_work_at_the_target_the_retreat_is_all_that_remains(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, f"at_target:{FIRST}")
    recover(engine, left)
    assert engine.upcoming is None
    assert len(again.motions("insert")) == 1
    assert len(again.motions("withdraw")) == 1


def test_a_retreat_that_was_killed_outside_the_entry_is_finished_from_there(cell: ClinicalCell) -> None:
    order = case_order(cell)
    engine = cell.engine(order)
    engine.run_to(order.find(f"at_target:{FIRST}"))
    cell.arm.blocked = lambda _start, _target: True  # the way home
    with pytest.raises(NotClear):
        engine.run_step(order.find(f"retreat:{FIRST}"))
    broken_off(cell)
    again, engine, left = opened_again(cell, order)
    recover(engine, left)
    assert again.workcell.at_home
    engine.run_to()
    assert engine.upcoming is None
    assert len(again.motions("withdraw")) == 1


class TestBringingHome:
    @pytest.mark.hazard(2)
    def test_nothing_moves_before_it_is_accepted(self, cell: ClinicalCell) -> None:
        again, engine, left = left_after(cell, f"positioning:{FIRST}")
        again.operator.refusing = (Topic.RESUME,)
        with pytest.raises(RecoveryRefused, match="PRO-032"):
            bring_home(engine, left)
        assert again.arm.motions == []
        assert "activate" not in again.arm.calls

    @pytest.mark.hazard(2)
    def test_the_guide_comes_back_first_and_the_run_is_taken_up_as_it_was(self, cell: ClinicalCell) -> None:
        order = case_order(cell)
        again, engine, left = left_after(cell, f"positioning:{FIRST}")
        assert bring_home(engine, left)
        assert [kind for kind, _ in again.arm.motions] == ["line", "joints"]
        assert again.workcell.at_home
        assert again.entries("accepted", "home", "result")[-2:] == [("accepted", ""), ("home", "")]
        broken_off(again)
        later, engine, left = opened_again(again, order)
        recover(engine, left)
        assert later.arm.motions == []
        assert str(engine.upcoming) == f"positioning:{FIRST}"
        engine.run_to()

    def test_an_arm_that_is_home_stays_there_unasked(self, cell: ClinicalCell) -> None:
        again, engine, left = left_after(cell, "tool_change")
        assert not bring_home(engine, left)
        assert again.operator.asked == []

    def test_neither_a_tracker_without_power_nor_a_record_out_of_date_keeps_the_arm_over_the_head(
        self, cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        def silent(timeout_s: float = 10.0) -> Identity:
            raise LinkTimeout("the tracker is silent")

        def expired(*_: object) -> None:
            raise CalibrationExpired("it expired in the night")

        again, engine, left = left_after(cell, f"positioning:{FIRST}")
        monkeypatch.setattr(again.tracker, "connect", silent)
        monkeypatch.setattr(DatedRecord, "check_valid_at", expired)
        assert bring_home(engine, left)
        (asked,) = (one for one in again.operator.asked if one.topic is Topic.RESUME)
        assert "the tracker is silent" in asked.value
        assert "it expired in the night" in asked.value

    def test_a_renewed_record_of_the_tracker_s_frame_does_not_keep_the_arm_over_the_head(
        self, cell: ClinicalCell
    ) -> None:
        again, engine, left = left_after(cell, f"positioning:{FIRST}")
        other_frame(again)
        assert bring_home(engine, left)
        (asked,) = (one for one in again.operator.asked if one.topic is Topic.RESUME)
        assert "calibration tracker_frame: not needed on the way home" in asked.value

    def test_another_tracker_does_not_keep_the_arm_over_the_head(self, cell: ClinicalCell) -> None:
        again, engine, left = left_after(cell, f"positioning:{FIRST}")
        again.tracker.name = "another tracker"
        assert bring_home(engine, left)

    def test_what_was_changed_beside_the_way_home_is_read_before_it_is_accepted(
        self, cell: ClinicalCell
    ) -> None:
        again, engine, left = left_after(cell, f"positioning:{FIRST}")
        changed = replace(left, changes=(Problem("notes.txt", "added: not part of the run"),))
        assert bring_home(engine, changed)
        assert "not as the run left it: notes.txt: added" in again.operator.asked[0].value

    @pytest.mark.hazard(2)
    def test_another_tip_is_not_led_out_along_the_axis(self, cell: ClinicalCell) -> None:
        again, engine, left = left_after(cell, f"positioning:{FIRST}")
        other_calibration(again)
        with pytest.raises(RecoveryRefused, match="tool_tip"):
            bring_home(engine, left)
        assert again.arm.motions == []

    @pytest.mark.hazard(2)
    def test_another_arm_is_not_moved(self, cell: ClinicalCell) -> None:
        again, engine, left = left_after(cell, f"positioning:{FIRST}")
        other_arm(again)
        with pytest.raises(RecoveryRefused, match="arm"):
            bring_home(engine, left)
        assert again.arm.motions == []


def other_tool(cell: ClinicalCell) -> None:
    cell.arm.mounted = STEREO_HEAD


def other_arm(cell: ClinicalCell) -> None:
    cell.arm.name = "another arm"


def other_calibration(cell: ClinicalCell) -> None:
    calibrations: Calibrations = cell.calibrations
    tip = calibrations.tool_tip.model_copy(update={"stated_error_mm": 0.5})
    cell.workcell.calibrations = calibrations.model_copy(update={"tool_tip": tip})


def other_frame(cell: ClinicalCell) -> None:
    calibrations: Calibrations = cell.calibrations
    frame = calibrations.tracker_frame.model_copy(update={"identifier": "renewed"})
    cell.workcell.calibrations = calibrations.model_copy(update={"tracker_frame": frame})


def other_camera(cell: ClinicalCell) -> None:
    cell.stereo.serials = ("0", "0")


@pytest.mark.hazard(2)
@pytest.mark.parametrize("swap", [other_tool, other_arm, other_calibration, other_frame, other_camera])
def test_what_was_swapped_meanwhile_is_refused_and_nothing_is_asked(
    cell: ClinicalCell, swap: Callable[[ClinicalCell], None]
) -> None:
    again, engine, left = left_after(cell, "tool_change")
    swap(again)
    with pytest.raises(RecoveryRefused, match="PRO-032"):
        recover(engine, left)
    assert again.operator.asked == []
    assert again.arm.motions == []


def longer_guide(engine: Engine) -> None:
    workcell = engine.setting.workcell
    guide = workcell.tools.guide
    bore = guide.bore.model_copy(update={"length_mm": guide.bore.length_mm + 20.0})
    records = {
        **workcell.tools.records,
        "guide": workcell.tools.records["guide"].model_copy(update={"bore": bore}),
    }
    workcell.tools = replace(workcell.tools, records=records)


def other_flange(engine: Engine) -> None:
    engine.setting.workcell.tools = replace(engine.setting.workcell.tools, flange="another flange")


def no_bodies(engine: Engine) -> None:
    cell = engine.setting.surroundings.model_copy(update={"bodies": ()})
    engine.setting = replace(engine.setting, surroundings=cell)


def other_settings(engine: Engine) -> None:
    settings = engine.setting.settings.model_copy(update={"standoff_mm": 12.0})
    engine.setting = replace(engine.setting, settings=settings)


@pytest.mark.hazard(2)
@pytest.mark.parametrize(
    ("change", "told"),
    [
        (longer_guide, r"tool record guide: recorded bore\.length_mm 8.*, found bore\.length_mm 10"),
        (other_flange, "flange: recorded '.*', found 'another flange'"),
        (no_bodies, "cell: recorded bodies 12 entries, found bodies 0 entries"),
        (other_settings, r"settings of the procedure: recorded standoff_mm 60\.0, found standoff_mm 12\.0"),
    ],
)
def test_another_theatre_file_is_refused_with_what_differs_and_nothing_is_asked(
    cell: ClinicalCell, change: Callable[[Engine], None], told: str
) -> None:
    again, engine, left = left_after(cell, "tool_check")
    change(engine)
    with pytest.raises(RecoveryRefused, match=told):
        recover(engine, left)
    assert again.operator.asked == []
    assert again.arm.motions == []


@pytest.mark.hazard(2)
def test_an_arm_that_was_moved_with_the_guide_before_an_entry_is_refused(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, f"positioning:{FIRST}")
    A1, *others = again.arm.joints_rad
    again.arm.joints_rad = (A1 + 0.02, *others)  # type: ignore[assignment]
    with pytest.raises(RecoveryRefused, match="guide"):
        recover(engine, left)
    assert again.arm.motions == []


@pytest.mark.hazard(1)
def test_a_plan_that_was_changed_is_refused(cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch) -> None:
    again, engine, left = left_after(cell, "tool_change")
    monkeypatch.setattr(inputs, "read_plan", lambda _path: checked_plan(margin_mm=9.0).plan)
    with pytest.raises(RecoveryRefused, match="plan"):
        recover(engine, left)
    assert again.arm.motions == []


def test_an_exchange_of_tools_that_had_begun_may_have_been_done(cell: ClinicalCell) -> None:
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


@pytest.fixture(autouse=True)
def plan_as_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(inputs, "read_plan", lambda _path: checked_plan().plan)
