"""After each target head, cart and guide are looked at again; what moved puts the targets since in doubt."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from clinical_case import FIRST, HOME_RAD, LAST, SPHERES_MM, ClinicalCell, done_later
from prepared_results import (
    checked_paths,
    checked_plan,
    correspondence,
    global_localization,
    localized_fiducials,
    locked_cart,
    mounted_guide,
    registered_robot,
)

from procedures.engine.engine import Engine
from procedures.engine.order import Scope
from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.guards.stability import Subject
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.operator.question import Topic
from procedures.steps.clinical import at_target, confirmation, positioning, retreat, tool_check
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.correspondence import Correspondence
from procedures.steps.clinical.global_localization import GlobalLocalization
from procedures.steps.clinical.results import ConfirmedTarget
from procedures.steps.clinical.tool_check import APPROACHES
from procedures.steps.errors import ToolBesideGauge
from procedures.strategies.fixed_orientation import NeutralOrientation
from procedures.workcell import MountedTool
from ronna_hw.arm.errors import NotClear
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.evidence.journal_reading import Entry
from ronna_hw.vectors import JointVector
from ronna_hw.wire.room_tasks import GAUGE

Change = Callable[[ClinicalCell], None]
NOTHING_MM = SPHERES_MM[:0]


@pytest.fixture
def engine(cell: ClinicalCell) -> Engine:
    return checked(cell)


def checked(cell: ClinicalCell) -> Engine:
    """The operation of a case of two targets, from the checked guide on."""
    cell.carrying(MountedTool.GUIDE)
    engine = cell.begin(
        *(localized_fiducials(), checked_plan(), checked_paths(cell)),
        done_later(locked_cart()),
        done_later(global_localization(), LockedCart),
        done_later(correspondence(), GlobalLocalization),
        done_later(registered_robot(), Correspondence, scope=Scope.LOCALIZATION),
        done_later(mounted_guide()),
        *(tool_check.STEP, positioning.STEP, at_target.STEP, retreat.STEP, confirmation.STEP),
    )
    engine.run_to(engine.order.find("tool_check"))
    return engine


def work_at(engine: Engine, trajectory: str) -> None:
    for name in ("positioning", "at_target", "retreat"):
        engine.run_step(engine.order.find(f"{name}:{trajectory}"))


def look_after(engine: Engine, trajectory: str) -> ConfirmedTarget:
    key = engine.order.find(f"confirmation:{trajectory}")
    engine.run_step(key)
    return engine.case.get(ConfirmedTarget, key.trajectory).result


def changed_after_the_first(cell: ClinicalCell, engine: Engine, change: Change) -> None:
    """The second target remains."""
    work_at(engine, FIRST)
    change(cell)


def changed_after_the_last(cell: ClinicalCell, engine: Engine, change: Change) -> None:
    """None remains, and the first was confirmed."""
    work_at(engine, FIRST)
    assert look_after(engine, FIRST).in_doubt == ()
    work_at(engine, LAST)
    change(cell)


def findings(cell: ClinicalCell) -> list[tuple[str, list[str]]]:
    """Text and targets of each finding."""
    lines = [line for line in read_journal(cell.folder / JOURNAL_FILE) if line["entry"] == Entry.FINDING]
    return [(str(line["text"]), list(line.get("targets", []))) for line in lines]


def seen_mm(result: ConfirmedTarget) -> dict[Subject, float | None]:
    return {one.subject: one.moved_mm for one in result.seen}


def gauge_readings(cell: ClinicalCell) -> int:
    return [task.name for task in cell.room.worked].count(GAUGE)


def head_moved(by_mm: float) -> Change:
    def move(cell: ClinicalCell) -> None:
        cell.tracker.spheres_mm = np.add(SPHERES_MM, (0.0, by_mm, 0.0))

    return move


def cart_crept(cell: ClinicalCell) -> None:
    cell.tracker.frame_shift_mm = (0.0, 0.5, 0.0)


def guide_bent(cell: ClinicalCell) -> None:
    cell.room.dials_mm = (1.0, 0.0, 0.0, 1.0, 0.0)


def head_covered(cell: ClinicalCell) -> None:
    cell.tracker.spheres_mm = SPHERES_MM[:2]


def frame_covered(cell: ClinicalCell) -> None:
    cell.tracker.hidden = True


def gauge_blocked(cell: ClinicalCell) -> None:
    cell.arm.blocked = lambda _start, target: target != cell.workcell.master.home_rad


@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
def test_a_quiet_look_finds_nothing_and_leaves_nothing_in_doubt(cell: ClinicalCell, engine: Engine) -> None:
    work_at(engine, FIRST)
    looked = look_after(engine, FIRST)
    assert looked.in_doubt == ()
    assert all(one.unchanged for one in looked.seen)
    assert seen_mm(looked)[Subject.HEAD] == pytest.approx(0.0, abs=1e-6)
    assert seen_mm(looked)[Subject.BASE] == pytest.approx(0.0, abs=1e-6)
    assert seen_mm(looked)[Subject.GUIDE] == pytest.approx(0.016, abs=0.001)  # as its record has the dials
    assert findings(cell) == []
    assert gauge_readings(cell) == 2 * APPROACHES  # of the tool check and of this look
    assert str(engine.upcoming) == f"positioning:{LAST}"


def test_the_arm_is_home_with_its_stream_ended_after_the_look(cell: ClinicalCell, engine: Engine) -> None:
    engine.run_to()
    assert engine.machine.state == "finished"
    assert cell.arm.joints_rad == HOME_RAD
    assert cell.arm.state is Lifecycle.CONFIGURED


@pytest.mark.hazard(36)
def test_the_way_to_the_gauge_and_the_way_home_are_asked_for(cell: ClinicalCell, engine: Engine) -> None:
    work_at(engine, FIRST)
    asked = len(cell.operator.asked)
    look_after(engine, FIRST)
    topics = [question.topic for question in cell.operator.asked[asked:]]
    assert topics == [Topic.TOOL_CHECK, *[Topic.INSTRUMENT_OUT] * APPROACHES, Topic.PARK]


@pytest.mark.hazard(12)
@pytest.mark.parametrize("hidden", [False, True])
def test_a_small_head_move_puts_the_target_in_doubt_and_the_next_registration_may_follow_it(
    cell: ClinicalCell, engine: Engine, hidden: bool
) -> None:
    for name in ("positioning", "at_target"):
        engine.run_step(engine.order.find(f"{name}:{FIRST}"))
    if hidden:
        cell.tracker.spheres_mm = NOTHING_MM
    engine.run_step(engine.order.find(f"retreat:{FIRST}"))
    head_moved(3.0)(cell)
    looked = look_after(engine, FIRST)
    assert looked.in_doubt == (FIRST,)
    assert seen_mm(looked)[Subject.HEAD] == pytest.approx(3.0, abs=0.01)
    assert {one.subject: one.differs for one in looked.seen} == {
        Subject.HEAD: True,
        Subject.BASE: True,
        Subject.GUIDE: False,
    }
    ((text, targets),) = findings(cell)
    assert targets == [FIRST]
    assert text.startswith(f"{FIRST} in doubt: the head has moved since it was localized, by 3.00 mm")
    assert str(engine.upcoming) == f"registration:{LAST}"
    assert engine.course.status(engine.order.find("global_localization")) == "done"


@pytest.mark.hazard(12)
def test_a_registration_of_all_targets_may_follow_a_small_head_move_for_those_that_remain(
    cell: ClinicalCell,
) -> None:
    cell.strategy = NeutralOrientation()
    engine = checked(cell)
    changed_after_the_first(cell, engine, head_moved(3.0))
    assert look_after(engine, FIRST).in_doubt == (FIRST,)
    assert str(engine.upcoming) == "registration"
    assert engine.course.status(engine.order.find(f"at_target:{FIRST}")) == "done"


@pytest.mark.hazard(12)
def test_a_head_that_moved_too_far_to_be_followed_is_localized_again(
    cell: ClinicalCell, engine: Engine
) -> None:
    changed_after_the_first(cell, engine, head_moved(8.0))
    with pytest.raises(PatientMoved, match="the head has moved"):
        look_after(engine, FIRST)
    assert [targets for _, targets in findings(cell)] == [[FIRST]]
    assert cell.entries("voided") == [("voided", "global_localization")]
    assert engine.course.status(engine.order.find(f"at_target:{FIRST}")) == "done"


@pytest.mark.hazard(13)
def test_a_cart_that_crept_by_half_a_millimetre_is_locked_again_before_the_next_target(
    cell: ClinicalCell, engine: Engine
) -> None:
    changed_after_the_first(cell, engine, cart_crept)
    with pytest.raises(
        BaseShifted,
        match=r"the cart of the robot was moved, .*: the frame on the arm by 0\.50 mm.*limit 0\.\d+ mm",
    ):
        look_after(engine, FIRST)
    assert [targets for _, targets in findings(cell)] == [[FIRST]]
    assert str(engine.upcoming) == "cart_lock"
    assert cell.motions("insert") == [FIRST]


@pytest.mark.hazard(3)
@pytest.mark.hazard(47)
def test_a_guide_bent_at_a_target_is_not_led_to_the_next(cell: ClinicalCell, engine: Engine) -> None:
    changed_after_the_first(cell, engine, guide_bent)
    looked = look_after(engine, FIRST)
    assert looked.in_doubt == (FIRST,)
    assert seen_mm(looked)[Subject.GUIDE] == pytest.approx(1.0, abs=0.02)
    assert [targets for _, targets in findings(cell)] == [[FIRST]]
    assert str(engine.upcoming) == "tool_check"
    with pytest.raises(ToolBesideGauge):
        engine.run_to()
    assert cell.motions("insert") == [FIRST]
    assert [targets for _, targets in findings(cell) if targets] == [[FIRST]]  # said once


@pytest.mark.hazard(3)
def test_a_guide_that_is_tilted_on_its_gauge_has_changed(cell: ClinicalCell, engine: Engine) -> None:
    work_at(engine, FIRST)
    cell.room.dials_mm = (0.0, 0.0, 0.0, 0.12, 0.0)  # 0.11 deg over 60 mm
    looked = look_after(engine, FIRST)
    assert looked.in_doubt == (FIRST,)
    assert str(engine.upcoming) == "tool_check"


@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
@pytest.mark.hazard(3)
@pytest.mark.parametrize("change", [head_moved(3.0), head_moved(8.0), cart_crept, guide_bent])
def test_after_the_last_target_a_change_is_a_finding_on_it_and_the_case_ends(
    cell: ClinicalCell, engine: Engine, change: Change
) -> None:
    changed_after_the_last(cell, engine, change)
    assert look_after(engine, LAST).in_doubt == (LAST,)  # the first was confirmed before
    assert [targets for _, targets in findings(cell)] == [[LAST]]
    assert cell.entries("voided") == []
    assert engine.machine.state == "finished"
    assert cell.workcell.master.place.is_home


@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
@pytest.mark.parametrize(
    ("cover", "unseen"), [(head_covered, "the head"), (frame_covered, "the frame on the arm")]
)
def test_what_the_tracker_does_not_see_puts_the_target_in_doubt_and_the_step_completes(
    cell: ClinicalCell, engine: Engine, cover: Change, unseen: str
) -> None:
    changed_after_the_first(cell, engine, cover)
    assert look_after(engine, FIRST).in_doubt == (FIRST,)
    said = [text for text, targets in findings(cell) if targets == [FIRST]]
    expected = f"after {FIRST} the tracker does not see {unseen}: it may have moved meanwhile"
    assert said == [f"{FIRST} in doubt: {expected}"]
    assert str(engine.upcoming) == f"positioning:{LAST}"  # which looks before it moves


@pytest.mark.hazard(13)
@pytest.mark.parametrize("way_mm", [(0.0, 0.5, 0.0), (0.0, 30.0, 0.0)], ids=["little", "far"])
def test_a_moved_tracker_puts_nothing_in_doubt(
    cell: ClinicalCell, engine: Engine, way_mm: tuple[float, float, float]
) -> None:
    work_at(engine, FIRST)
    cell.tracker.frame_shift_mm, cell.tracker.spheres_mm = way_mm, np.add(SPHERES_MM, way_mm)
    assert look_after(engine, FIRST).in_doubt == ()
    ((text, targets),) = findings(cell)
    assert targets == []
    assert "head and arm agree" in text
    assert str(engine.upcoming) == f"positioning:{LAST}"


@pytest.mark.hazard(3)
def test_a_gauge_out_of_reach_puts_the_target_in_doubt_and_head_and_cart_are_looked_at(
    cell: ClinicalCell, engine: Engine
) -> None:
    changed_after_the_first(cell, engine, gauge_blocked)
    looked = look_after(engine, FIRST)
    assert looked.in_doubt == (FIRST,)
    assert seen_mm(looked)[Subject.GUIDE] is None
    assert seen_mm(looked)[Subject.HEAD] == pytest.approx(0.0, abs=1e-6)
    ((text, targets),) = findings(cell)
    assert targets == [FIRST]
    assert "the gauge cannot be reached, so the guide was not checked" in text


def test_an_arm_that_cannot_leave_the_gauge_ends_the_look(cell: ClinicalCell, engine: Engine) -> None:
    work_at(engine, FIRST)

    def blocked_at_the_gauge(_start: JointVector, _target: JointVector) -> bool:
        return gauge_readings(cell) > APPROACHES  # those of the tool check

    cell.arm.blocked = blocked_at_the_gauge
    with pytest.raises(NotClear):
        look_after(engine, FIRST)
    assert not cell.workcell.master.place.is_home


@pytest.mark.hazard(12)
def test_targets_that_were_not_confirmed_are_in_doubt_together(cell: ClinicalCell, engine: Engine) -> None:
    work_at(engine, FIRST)
    work_at(engine, LAST)  # by hand, without the look between
    head_moved(3.0)(cell)
    assert look_after(engine, LAST).in_doubt == (FIRST, LAST)
    assert [targets for _, targets in findings(cell)] == [[FIRST, LAST]]


def test_the_look_waits_for_the_arm_to_be_home(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path).carrying(MountedTool.GUIDE)
    engine = cell.begin(confirmation.STEP)
    A1, *others = cell.arm.joints_rad
    cell.arm.joints_rad = (A1 + 0.2, *others)
    engine.compare_places()  # as before any step: somebody has jogged it
    key = engine.order.find(f"confirmation:{FIRST}")
    (unmet,) = confirmation.STEP.preconditions(engine.context(key))
    assert unmet.startswith("the arm is not home")
