"""Head clamp and cart before the localization: people act, and the tracker checks what it can."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from clinical_case import ROBOT_FROM_CT, SPHERES_MM, ClinicalCell
from coded_errors import raises
from prepared_results import SERIES, checked_plan, checked_set_up, clamped_head, localized_fiducials
from watched_case import findings

from procedures.engine.order import StepSpec
from procedures.guards.errors import PatientMoved
from procedures.journal.errors import GateFailed, StepRefused
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Task, Topic
from procedures.planning.errors import PLACE_UNFIT
from procedures.steps.branches import AS_IT_STANDS, HOLD, PLACINGS
from procedures.steps.clinical import cart_lock, head_clamp
from procedures.steps.clinical.cart_lock import LockedCart
from procedures.steps.clinical.head_clamp import ClampedHead
from procedures.steps.errors import CART_NOT_LOCKED, CART_OUT_OF_PLACE
from procedures.workcell import MountedTool
from procedures.workcell.arm_history import ArmHistory, ArmPlace, InsertionAxis, PlaceKind
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.wire.room_tasks import CART_LOCK, CART_PLACE, CART_PUSH, HEAD_CLAMP


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path / "run").carrying(MountedTool.STEREO_HEAD)


def clamp(cell: ClinicalCell) -> ClampedHead:
    found = cell.run(checked_plan(), checked_set_up(cell), head_clamp.STEP).result
    assert isinstance(found, ClampedHead)
    return found


def lock(cell: ClinicalCell) -> LockedCart:
    before = (localized_fiducials(), checked_plan(), checked_set_up(cell), clamped_head())
    found = cell.run(*before, cart_lock.STEP).result
    assert isinstance(found, LockedCart)
    return found


def when_done(cell: ClinicalCell, name: str, happens: Callable[[], None]) -> None:
    """Something happens in the room with a task."""
    work = cell.room.work

    def working(task: Task) -> tuple[float, ...]:
        if task.name == name:
            happens()
        return work(task)

    cell.room.work = working  # type: ignore[method-assign]


def tasks(cell: ClinicalCell) -> list[str]:
    return [task.name for task in cell.room.worked]


def test_a_clamped_head_is_seen_by_the_tracker_and_confirmed_in_its_planned_position(
    cell: ClinicalCell,
) -> None:
    assert clamp(cell).spheres == len(SPHERES_MM)
    assert tasks(cell) == [HEAD_CLAMP]
    (question,) = [one for one in cell.operator.asked if one.topic is Topic.HEAD_CLAMPED]
    assert "HFS" in question.value
    assert "4 spheres" in question.value


def test_an_unconfirmed_or_unseen_head_clamp_is_refused(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path / "1").carrying(MountedTool.STEREO_HEAD)
    cell.operator.refusing = (Topic.HEAD_CLAMPED,)
    with pytest.raises(NotConfirmed, match="PRO-002"):
        clamp(cell)
    cell = ClinicalCell(tmp_path / "2").carrying(MountedTool.STEREO_HEAD)
    cell.tracker.spheres_mm = SPHERES_MM[:2]
    with pytest.raises(GateFailed, match="too few spheres"):
        clamp(cell)


@pytest.mark.hazard(49)
@pytest.mark.parametrize(("step", "confirmed"), [("head_clamp", 1), ("cart_lock", 2)])
def test_the_arm_is_inactive_and_each_measurement_waits_until_the_hands_are_done(
    cell: ClinicalCell, step: str, confirmed: int
) -> None:
    asked_by_then: list[int] = []
    read = cell.tracker.read_frame

    def reading(*arguments, **options):  # type: ignore[no-untyped-def]
        asked_by_then.append(len(cell.operator.asked))
        assert cell.arm.state is not Lifecycle.ACTIVE
        return read(*arguments, **options)

    cell.workcell.start()
    cell.tracker.read_frame = reading  # type: ignore[method-assign]
    {"head_clamp": clamp, "cart_lock": lock}[step](cell)
    assert sorted(set(asked_by_then)) == list(range(1, confirmed + 1))


def test_a_cart_is_placed_locked_confirmed_and_push_tested(cell: ClinicalCell) -> None:
    found = lock(cell)
    assert tasks(cell) == [CART_PLACE, CART_LOCK, CART_PUSH]
    assert np.linalg.norm(found.moved_mm) < 1e-6
    assert (found.placings, found.spheres, found.beside_mm) == (1, len(SPHERES_MM), None)
    assert cell.arm.motions == []


@pytest.mark.hazard(49)
@pytest.mark.branch("CART_UNLOCKED")
def test_a_cart_that_is_not_confirmed_locked_is_refused(cell: ClinicalCell) -> None:
    cell.operator.refusing = (Topic.CART_LOCKED,)
    with raises(CART_NOT_LOCKED, match=r"PRO-041.*Lock the brakes") as refused:
        lock(cell)
    assert refused.value.exit_code == 3
    assert CART_PUSH not in tasks(cell)


@pytest.mark.hazard(49)
@pytest.mark.branch("CART_UNLOCKED")
def test_a_cart_that_rolls_in_the_push_test_is_refused(cell: ClinicalCell) -> None:
    def roll() -> None:
        cell.tracker.frame_shift_mm = (0.3, 0.3, 0.0)

    when_done(cell, CART_PUSH, roll)
    with raises(CART_NOT_LOCKED, match=r"rolled.*0\.42 mm"):
        lock(cell)


@pytest.mark.hazard(12)
def test_a_head_that_slips_during_the_push_test_is_not_taken_for_a_rolling_cart(cell: ClinicalCell) -> None:
    def slip() -> None:
        cell.tracker.spheres_mm = np.add(SPHERES_MM, (0.0, 0.5, 0.0))

    when_done(cell, CART_PUSH, slip)
    with pytest.raises(PatientMoved, match="not clamped"):
        lock(cell)
    assert cell.entries("voided") == [("voided", "head_clamp")]


def test_a_tracker_that_moves_during_the_push_test_is_not_taken_for_a_rolling_cart(
    cell: ClinicalCell,
) -> None:
    def push() -> None:
        cell.tracker.spheres_mm = np.add(SPHERES_MM, (0.0, 2.0, 0.0))
        cell.tracker.frame_shift_mm = (0.0, 2.0, 0.0)

    when_done(cell, CART_PUSH, push)
    assert np.linalg.norm(lock(cell).moved_mm) < 1e-6


def test_the_push_test_fails_without_sight_of_the_frame(cell: ClinicalCell) -> None:
    def hide() -> None:
        cell.tracker.hidden = True

    when_done(cell, CART_PUSH, hide)
    with pytest.raises(GateFailed, match="before and after"):
        lock(cell)


def test_the_cart_is_not_pushed_while_a_guide_is_held_at_the_head(cell: ClinicalCell) -> None:
    engine = cell.begin(
        *(localized_fiducials(), checked_plan(), checked_set_up(cell), clamped_head()), cart_lock.STEP
    )
    engine.run_to(engine.order.find("head_clamp"))
    cell.arm.joints_rad = tuple(angle + 0.3 for angle in cell.arm.joints_rad)
    held = InsertionAxis("T1", cell.workcell.master.tool_pose(), travel_mm=60.0)
    cell.workcell.master.restore_history(ArmHistory(place=ArmPlace(PlaceKind.ON_AXIS, held)))
    with pytest.raises(StepRefused, match="held in front of the entry of T1"):
        engine.run_to()


@pytest.mark.parametrize("step", [head_clamp.STEP, cart_lock.STEP])
def test_clamp_and_cart_are_handled_only_with_the_arm_at_home(
    cell: ClinicalCell, step: StepSpec[object]
) -> None:
    before = (localized_fiducials(), checked_plan(), checked_set_up(cell))
    engine = cell.begin(*before, *([clamped_head()] if step is cart_lock.STEP else []), step)
    cell.arm.joints_rad = tuple(angle + 0.3 for angle in cell.arm.joints_rad)
    with pytest.raises(StepRefused, match="the arm is not home"):
        engine.run_to()
    assert tasks(cell) == []


def propose(cell: ClinicalCell, push_mm: tuple[float, float] = (0.0, 0.0), **changes: object) -> None:
    """A map that proposes to push the cart by that from where it stands."""
    pose = Pose.from_matrix(ROBOT_FROM_CT.as_matrix().tolist())
    proposal = {
        "series_instance_uid": SERIES,
        "assumed_robot_from_ct": list(pose.to_kuka()),
        "best_mm": list(push_mm),
        "turned_deg": 0.0,
        "free_mm": 40.0,
        "turns_deg": [5.0, 5.0],
        "map": ["#"],
        **changes,
    }
    cell.setting().clinical.place.write_text(json.dumps(proposal))  # type: ignore[union-attr]


@pytest.mark.hazard(49)
def test_a_cart_within_tolerance_of_its_place_is_accepted(cell: ClinicalCell) -> None:
    propose(cell, (20.0, -10.0))
    found = lock(cell)
    assert found.beside_mm == pytest.approx((-20.0, 10.0), abs=0.01)
    assert found.turned_deg == pytest.approx(0.0, abs=0.01)
    assert Topic.CART_PLACE not in [question.topic for question in cell.operator.asked]


@pytest.mark.hazard(49)
@pytest.mark.branch("CART_MISPLACED")
def test_a_cart_out_of_tolerance_is_placed_again_with_instructions_and_finally_refused(
    cell: ClinicalCell,
) -> None:
    propose(cell, (60.0, 0.0))
    with raises(CART_OUT_OF_PLACE, match=r"PRO-042.*60 mm \(x -60, y \+0\).*Push it by x \+60 mm"):
        lock(cell)
    assert tasks(cell) == [CART_PLACE, CART_LOCK] * PLACINGS


@pytest.mark.branch("CART_MISPLACED")
def test_a_cart_pushed_into_place_is_locked_there(cell: ClinicalCell) -> None:
    propose(cell, (60.0, 0.0))
    pushed = iter([0.0, 60.0])

    def push() -> None:
        cell.tracker.frame_shift_mm = (next(pushed), 0.0, 0.0)

    when_done(cell, CART_PLACE, push)
    found = lock(cell)
    assert found.placings == 2
    assert found.beside_mm == pytest.approx((0.0, 0.0), abs=0.01)


@pytest.mark.branch("CART_MISPLACED")
def test_the_operator_may_accept_a_misplaced_cart_and_leave_it_to_the_path_check(cell: ClinicalCell) -> None:
    propose(cell, (60.0, 0.0))
    cell.operator.answers = {Topic.CART_PLACE: AS_IT_STANDS}
    assert lock(cell).beside_mm == pytest.approx((-60.0, 0.0), abs=0.01)


@pytest.mark.branch("CART_MISPLACED")
def test_the_operator_may_hold_the_case_because_of_a_misplaced_cart(cell: ClinicalCell) -> None:
    propose(cell, (60.0, 0.0))
    cell.operator.answers = {Topic.CART_PLACE: HOLD}
    with raises(CART_OUT_OF_PLACE):
        lock(cell)
    assert tasks(cell) == [CART_PLACE, CART_LOCK]


@pytest.mark.hazard(49)
@pytest.mark.parametrize(
    ("turned_deg", "push_mm", "stays"),
    [(4.0, (0.0, 0.0), True), (-6.0, (0.0, 0.0), False), (4.0, (30.0, 0.0), False), (0.0, (30.0, 0.0), True)],
)
def test_a_turned_cart_has_a_smaller_position_tolerance(
    cell: ClinicalCell, turned_deg: float, push_mm: tuple[float, float], stays: bool
) -> None:
    propose(cell, push_mm, turned_deg=turned_deg)
    if stays:
        assert lock(cell).turned_deg == pytest.approx(-turned_deg, abs=0.01)
    else:
        with raises(CART_OUT_OF_PLACE, match=re.escape(f"turn it by {turned_deg:+.1f} deg")):
            lock(cell)


def test_a_head_higher_than_the_map_assumes_is_a_finding(cell: ClinicalCell) -> None:
    pose = Pose.from_matrix(ROBOT_FROM_CT.as_matrix().tolist())
    x, y, z, a, b, c = pose.to_kuka()
    propose(cell, assumed_robot_from_ct=[x, y, z - 30.0, a, b, c])
    lock(cell)
    (finding,) = findings(cell)
    assert "is +30 mm higher" in finding


@pytest.mark.parametrize(
    ("content", "why"), [("{", "Invalid JSON"), ("{}", "series_instance_uid"), (None, "made for another CT")]
)
def test_an_unusable_place_file_is_refused(cell: ClinicalCell, content: str | None, why: str) -> None:
    propose(cell, series_instance_uid="1.2.3")
    if content is not None:
        cell.setting().clinical.place.write_text(content)  # type: ignore[union-attr]
    with raises(PLACE_UNFIT, match=f"PLAN-022.*{why}"):
        lock(cell)
