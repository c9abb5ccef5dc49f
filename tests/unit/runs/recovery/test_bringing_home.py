"""Only the arm of the case is brought home: by checking what the way needs, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest
from clinical_case import FIRST, ClinicalCell
from coded_errors import raises
from left_operation import case_order, left_after, other_arm, other_calibration, other_frame
from run_again import broken_off, opened_again

from procedures.engine.engine import Engine
from procedures.engine.errors import RECOVERY_REFUSED
from procedures.operator.question import Topic
from procedures.runs.arm_notes import NOT_KNOWN
from procedures.runs.interrupted_run import InterruptedRun
from procedures.runs.recovery import bring_home, recover
from ronna_hw.calibration import CalibrationExpired, DatedRecord
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.errors import LinkTimeout
from ronna_hw.evidence.inspection import Problem


@pytest.mark.hazard(2)
def test_nothing_moves_before_the_operator_accepts(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, f"positioning:{FIRST}")
    again.operator.refusing = (Topic.RESUME,)
    with raises(RECOVERY_REFUSED, match="PRO-032"):
        bring_home(engine, left)
    assert again.arm.motions == []
    assert "activate" not in again.arm.calls


@pytest.mark.hazard(2)
def test_the_guide_is_withdrawn_first_and_the_run_then_resumes_as_before(cell: ClinicalCell) -> None:
    order = case_order(cell)
    again, engine, left = left_after(cell, f"positioning:{FIRST}")
    assert bring_home(engine, left)
    assert [kind for kind, _ in again.arm.motions] == ["line", "joints", "joints"]
    assert again.workcell.master.place.is_home
    assert again.entries("accepted", "home", "result")[-2:] == [("accepted", ""), ("home", "")]
    broken_off(again)
    later, engine, left = opened_again(again, order)
    recover(engine, left)
    assert later.arm.motions == []
    assert str(engine.upcoming) == f"positioning:{FIRST}"
    engine.run_to()


def test_an_arm_at_home_stays_there_and_nothing_is_asked(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, "tool_change")
    assert not bring_home(engine, left)
    assert again.operator.asked == []


def test_a_silent_tracker_and_an_expired_record_do_not_keep_the_arm_over_the_head(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
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


def test_another_tracker_and_a_renewed_record_of_its_frame_do_not_keep_the_arm_over_the_head(
    cell: ClinicalCell,
) -> None:
    again, engine, left = left_after(cell, f"positioning:{FIRST}")
    other_frame(again)
    again.tracker.name = "another tracker"
    assert bring_home(engine, left)
    (asked,) = (one for one in again.operator.asked if one.topic is Topic.RESUME)
    assert "calibration tracker_frame: a different one; not needed on the way home" in asked.value


def test_changes_that_do_not_concern_the_way_home_are_shown_before_acceptance(cell: ClinicalCell) -> None:
    again, engine, left = left_after(cell, f"positioning:{FIRST}")
    added = Problem("notes.txt", "added: not part of the run")
    changed = replace(left, run=replace(left.run, problems=(added,)))
    assert bring_home(engine, changed)
    assert "not as the run left it: notes.txt: added" in again.operator.asked[0].value


@pytest.mark.hazard(2)
@pytest.mark.parametrize(("swap", "named"), [(other_calibration, "tool_tip"), (other_arm, "arm")])
def test_another_arm_or_a_guide_with_another_tip_is_not_withdrawn_along_the_axis(
    cell: ClinicalCell, swap: Callable[[ClinicalCell], None], named: str
) -> None:
    again, engine, left = left_after(cell, f"positioning:{FIRST}")
    swap(again)
    with raises(RECOVERY_REFUSED, match=named):
        bring_home(engine, left)
    assert again.arm.motions == []


B_LEFT = "run B left the arm away from its home; ronna-procedure home B brings it there"


@pytest.mark.hazard(2)
@pytest.mark.parametrize("way", [bring_home, recover])
def test_an_arm_that_another_run_left_away_is_not_moved_by_this_one(
    cell: ClinicalCell, way: Callable[[Engine, InterruptedRun], object]
) -> None:
    again, engine, left = left_after(cell, "tool_change")
    joints_rad = again.arm.joints_rad
    again.arm.joints_rad = (*joints_rad[:5], joints_rad[5] + 0.1)
    engine.setting = replace(engine.setting, arm_not_home=B_LEFT)
    with raises(RECOVERY_REFUSED, match=f"PRO-032.*{B_LEFT}") as refused:
        way(engine, left)
    assert "new run" not in refused.value.advice  # it would take that position for its home
    assert again.arm.motions == []
    assert again.operator.asked == []


def test_an_arm_that_was_jogged_home_after_another_run_does_not_keep_this_one_from_going_on(
    cell: ClinicalCell,
) -> None:
    again, engine, left = left_after(cell, "tool_change")
    engine.setting = replace(engine.setting, arm_not_home=B_LEFT)
    recover(engine, left)
    assert B_LEFT in again.operator.asked[0].value


@pytest.mark.parametrize("way", [bring_home, recover])
def test_where_no_note_says_who_moved_the_arm_last_the_operator_decides(
    cell: ClinicalCell, way: Callable[[Engine, InterruptedRun], object]
) -> None:
    again, engine, left = left_after(cell, f"positioning:{FIRST}")
    assert not again.workcell.master.place.is_home
    engine.setting = replace(engine.setting, arm_not_home=NOT_KNOWN)
    way(engine, left)
    assert NOT_KNOWN in again.operator.asked[0].value
