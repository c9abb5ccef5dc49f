"""Hazard 47: after a restart, a fault of the arm or another tool the guide returns to the gauge first.

The controller reports a number, which the same guide bent, or another one, has too.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from clinical_case import FIRST, LAST, ClinicalCell, done_later, given
from coded_errors import raises
from left_operation import left_with_an_instrument_inside
from prepared_results import (
    checked_paths,
    checked_plan,
    checked_set_up,
    correspondence,
    global_localization,
    localized_fiducials,
    mounted_guide,
    registered_robot,
)
from recording_cell import GUIDE
from run_again import broken_off, opened_again

from procedures.engine.engine import Engine
from procedures.engine.errors import TOOL_UNCHECKED
from procedures.engine.order import CaseOrder, Scope, order_of
from procedures.guards.default_guards import ToolStillMounted
from procedures.guards.room_watch import RoomLook
from procedures.journal.errors import StepRefused
from procedures.operator import checkpoint
from procedures.operator.question import Question, Topic
from procedures.runs import comparison, recovery
from procedures.runs.recovery import recover
from procedures.steps.clinical import at_target, confirmation, positioning, retreat, tool_check
from procedures.steps.clinical.set_up import DeviceIdentity
from procedures.steps.errors import ToolBesideGauge
from procedures.workcell import MountedTool
from procedures.workcell.errors import WrongTool
from ronna_hw.devices.lifecycle import Identity, Lifecycle
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, Entry, read_journal
from ronna_hw.wire.room_tasks import GAUGE

pytestmark = pytest.mark.hazard(47)


@pytest.fixture(autouse=True)
def a_room_as_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    """Tracker and plan have their own tests."""
    monkeypatch.setattr(recovery, "compare_room", lambda _engine, _comparison: True)
    monkeypatch.setattr(comparison, "read_plan", lambda _path: checked_plan().plan)


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path / "run").carrying(MountedTool.GUIDE)


def operation(cell: ClinicalCell, *trajectories: str) -> CaseOrder:
    """From the tool check on, with everything before it given."""
    identities = {
        role: DeviceIdentity.from_identity(Identity("Test", f"a {role}", "1", "0"))
        for role in cell.workcell.devices
    }
    set_up = checked_set_up(cell).model_copy(update={"identities": identities})
    before = (localized_fiducials(), checked_plan(), set_up, global_localization(), correspondence())
    steps = [
        *map(given, before),
        given(checked_paths(cell)),
        replace(given(registered_robot()), scope=Scope.LOCALIZATION),
        done_later(mounted_guide()),
        *(tool_check.STEP, positioning.STEP, at_target.STEP, retreat.STEP, confirmation.STEP),
    ]
    return order_of(steps, trajectories or (FIRST, LAST))


def restarted(cell: ClinicalCell, order: CaseOrder, last: str) -> tuple[ClinicalCell, Engine]:
    """Killed after that step, and taken up again."""
    cell.engine(order).run_to(order.find(last))
    broken_off(cell)
    again, engine, left = opened_again(cell, order)
    recover(engine, left)
    return again, engine


def gauge_readings(cell: ClinicalCell) -> int:
    return [task.name for task in cell.room.worked].count(GAUGE)


def steps_done(cell: ClinicalCell) -> list[str]:
    return [step for kind, step in cell.entries() if kind == "result"]


@pytest.mark.hazard(2)
def test_the_guide_is_checked_again_after_a_restart_before_it_goes_to_the_head(cell: ClinicalCell) -> None:
    again, engine = restarted(cell, operation(cell), "tool_check")

    assert str(engine.upcoming) == "tool_check"
    with pytest.raises(StepRefused, match="tool_check comes first"):
        engine.run_step(engine.order.find(f"positioning:{FIRST}"))
    engine.run_to(engine.order.find(f"positioning:{FIRST}"))
    assert gauge_readings(again) == tool_check.APPROACHES


@pytest.mark.hazard(2)
def test_a_guide_bent_while_the_program_was_down_does_not_go_to_the_head(cell: ClinicalCell) -> None:
    again, engine = restarted(cell, operation(cell), "tool_check")
    again.room.dials_mm = (2.0, 2.0, 0.0, 2.0, 2.0)
    with pytest.raises(ToolBesideGauge):
        engine.run_to()
    assert again.motions("insert") == []


def test_the_restart_question_announces_the_repeated_tool_check(cell: ClinicalCell) -> None:
    again, _ = restarted(cell, operation(cell, FIRST), f"positioning:{FIRST}")
    said = again.operator.asked[0].value.split("\n")
    assert (
        f"remaining steps: tool_check, positioning:{FIRST}, at_target:{FIRST}, retreat:{FIRST}, "
        f"confirmation:{FIRST}"
    ) in said
    assert any("tool_check is repeated" in line for line in said)


def test_an_instrument_in_the_guide_comes_out_before_the_check(cell: ClinicalCell) -> None:
    again, engine, left = left_with_an_instrument_inside(cell, operation(cell))
    recover(engine, left)
    assert again.operator.asked[1].topic is Topic.INSTRUMENT_OUT
    assert gauge_readings(again) == 0
    assert again.workcell.master.place.is_home
    assert str(engine.upcoming) == "tool_check"


def test_the_retreat_from_a_finished_target_comes_before_the_check_and_its_work_is_not_repeated(
    cell: ClinicalCell,
) -> None:
    again, engine = restarted(cell, operation(cell), f"at_target:{FIRST}")
    engine.run_to()
    since = steps_done(again)[steps_done(again).index(f"at_target:{FIRST}") + 1 :]
    assert since == [
        *(f"retreat:{FIRST}", "tool_check"),  # which is the look at the guide after that target
        *(f"{step}:{LAST}" for step in ("positioning", "at_target", "retreat", "confirmation")),
    ]
    assert engine.over


def test_a_guide_found_bent_after_a_restart_puts_the_finished_target_in_doubt(cell: ClinicalCell) -> None:
    again, engine = restarted(cell, operation(cell), f"at_target:{FIRST}")
    again.room.dials_mm = (1.0, 0.0, 0.0, 1.0, 0.0)
    with pytest.raises(ToolBesideGauge):
        engine.run_to()
    found = [line for line in read_journal(again.folder / JOURNAL_FILE) if line["entry"] == Entry.FINDING]
    (said,) = (str(line["text"]) for line in found if line.get("targets") == [FIRST])
    assert said.startswith(f"{FIRST} in doubt: the guide is not as it was when its tip was calibrated")


def test_once_every_target_is_finished_the_guide_is_only_read_after_the_last(cell: ClinicalCell) -> None:
    again, engine = restarted(cell, operation(cell, FIRST), f"at_target:{FIRST}")
    engine.run_to()
    assert engine.over
    assert steps_done(again)[-2:] == [f"retreat:{FIRST}", f"confirmation:{FIRST}"]
    assert steps_done(again).count("tool_check") == 1  # before the restart
    assert gauge_readings(again) == tool_check.APPROACHES


def fault(cell: ClinicalCell, engine: Engine) -> None:
    """A fault of the arm in a case that stays open, acknowledged by a person."""
    cell.arm.state = Lifecycle.FAULT
    engine.faults.acknowledge("A. Nurse")
    cell.arm.state = Lifecycle.CONFIGURED


@pytest.mark.hazard(12)
def test_the_guide_is_checked_again_after_a_fault_of_the_arm(cell: ClinicalCell) -> None:
    engine = cell.engine(operation(cell))
    engine.run_to(engine.order.find("tool_check"))
    fault(cell, engine)
    assert str(engine.upcoming) == "tool_check"
    (voided,) = (line for line in read_journal(cell.folder / JOURNAL_FILE) if line["entry"] == Entry.VOIDED)
    assert voided["step"] == "tool_check"
    assert voided["code"] == "PRO-027"


@pytest.mark.hazard(12)
def test_work_at_an_entry_is_finished_before_the_check_after_a_fault(cell: ClinicalCell) -> None:
    engine = cell.engine(operation(cell))
    engine.run_to(engine.order.find(f"positioning:{FIRST}"))
    fault(cell, engine)
    assert str(engine.upcoming) == f"at_target:{FIRST}"
    engine.run_to(engine.order.find(f"retreat:{FIRST}"))
    assert str(engine.upcoming) == "tool_check"
    engine.run_to()
    assert steps_done(cell).count(f"at_target:{FIRST}") == 1
    assert engine.over


@pytest.mark.hazard(12)
def test_the_way_home_after_a_fault_at_an_entry_leads_to_the_gauge(cell: ClinicalCell) -> None:
    engine = cell.engine(operation(cell))
    engine.run_to(engine.order.find(f"positioning:{FIRST}"))
    fault(cell, engine)
    engine.retreat_home()
    assert str(engine.upcoming) == "tool_check"


@pytest.fixture
def guarded(cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch) -> Engine:
    """A case whose guide was just checked, and is mounted again when a guard asks for it."""
    monkeypatch.setattr(checkpoint, "PATIENCE_S", 0.0)
    engine = cell.engine(operation(cell))
    engine.checkpoint.guards.append(ToolStillMounted(cell.workcell, engine.doubt_tool))
    engine.run_to(engine.order.find("tool_check"))
    mounts(cell, Topic.GUARD, GUIDE)
    return engine


def mounts(cell: ClinicalCell, topic: Topic, number: int) -> None:
    """At that question somebody takes the guide off, or mounts it."""
    before = cell.operator.meanwhile

    def meanwhile(question: Question) -> None:
        before(question)
        if question.topic is topic:
            cell.arm.mounted = number

    cell.operator.meanwhile = meanwhile


@pytest.mark.hazard(3)
def test_a_guide_found_off_before_it_goes_to_the_head_is_checked_again(
    cell: ClinicalCell, guarded: Engine, monkeypatch: pytest.MonkeyPatch
) -> None:
    look_from_home = positioning.room.require_unmoved

    def unmounted_after(*arguments: Any) -> RoomLook:
        look = look_from_home(*arguments)
        cell.arm.mounted = 0
        return look

    monkeypatch.setattr(positioning.room, "require_unmoved", unmounted_after)
    with raises(TOOL_UNCHECKED, match="no tool instead of the guide"):
        guarded.run_step(guarded.order.find(f"positioning:{FIRST}"))
    cell.arm.mounted = GUIDE
    assert cell.motions("go") == []
    assert str(guarded.upcoming) == "tool_check"
    assert cell.entries("doubted", "voided") == [("doubted", ""), ("voided", "tool_check")]


@pytest.mark.hazard(3)
def test_a_guide_found_off_after_a_question_is_checked_again(cell: ClinicalCell, guarded: Engine) -> None:
    mounts(cell, Topic.APPROACH, 0)
    with pytest.raises(WrongTool):
        guarded.run_step(guarded.order.find(f"positioning:{FIRST}"))
    cell.arm.mounted = GUIDE
    assert str(guarded.upcoming) == "tool_check"


@pytest.mark.hazard(3)
def test_a_guide_found_off_at_an_entry_is_checked_again_after_the_way_out(
    cell: ClinicalCell, guarded: Engine
) -> None:
    mounts(cell, Topic.DRILL, 0)
    guarded.run_to(guarded.order.find(f"retreat:{FIRST}"))
    assert cell.motions("withdraw") == [FIRST]
    assert str(guarded.upcoming) == "tool_check"


@pytest.mark.hazard(3)
def test_a_guide_found_off_on_the_way_home_does_not_end_it(cell: ClinicalCell, guarded: Engine) -> None:
    A1, *others = cell.arm.joints_rad
    cell.arm.joints_rad, cell.arm.mounted = (A1 + 0.2, *others), 0
    guarded.retreat_home()
    assert cell.workcell.master.place.is_home
    assert str(guarded.upcoming) == "tool_check"


@pytest.mark.hazard(12)
def test_the_doubt_about_the_guide_survives_a_restart(cell: ClinicalCell) -> None:
    order = operation(cell)
    engine = cell.engine(order)
    engine.run_to(order.find(f"positioning:{FIRST}"))
    cell.arm.state = Lifecycle.FAULT
    engine.close("left")
    _, engine, _ = opened_again(cell, order)
    assert engine.case.doubt_at(order.find("tool_check")) is not None
