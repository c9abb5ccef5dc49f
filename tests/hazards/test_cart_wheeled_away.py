"""Hazard 13: the cart is wheeled away while the arm moves, looks or holds an instrument."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from clinical_case import FIRST, SPHERES_MM, ClinicalCell, SeeingTracker, SeeingWorkcell
from prepared_results import checked_paths, checked_plan, coarse, localized_fiducials
from room_trials import TrackedCase
from waiting import eventually
from watched_case import findings, on_the_way, positioned, watched

from procedures.guards.errors import BaseShifted
from procedures.guards.room_motion import GROSS_LIMIT_MM
from procedures.operator.question import Topic
from procedures.room.sighting import Tracked
from procedures.runs.engine_setup import MovedCart
from procedures.steps.clinical import relocalization
from procedures.workcell import MountedTool
from procedures.workcell.arm_history import MotionKind
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.vectors import Vector3, vector3

pytestmark = pytest.mark.hazard(13)

AWAY_MM = (60.0, -40.0, 0.0)


def leave_by(cell: ClinicalCell, way_mm: tuple[float, float, float]) -> None:
    """The cart is wheeled away: the frame on the arm with it."""
    assert isinstance(cell.tracker, SeeingTracker)
    cell.tracker.frame_shift_mm = way_mm


def cart_leaves(cell: ClinicalCell) -> Callable[[], None]:
    """The cart leaves, and the motion goes on until somebody stops it."""

    def leave() -> None:
        leave_by(cell, AWAY_MM)
        eventually(lambda: cell.arm.stops > 0)
        cell.arm.interruptions = 1

    return leave


@pytest.mark.branch("CART_MOVED")
def test_a_cart_that_leaves_during_a_motion_stops_the_arm(cell: ClinicalCell) -> None:
    engine = watched(cell)
    on_the_way(cell, cart_leaves(cell))
    with pytest.raises(
        BaseShifted,
        match=r"the cart .* was moved, the frame on the arm by 72\.11 mm .*, during the motion 'go'",
    ):
        positioned(engine)
    assert cell.arm.motions == []  # it has not arrived
    assert engine.machine.state == "held"


def test_head_and_spheres_are_expected_where_they_are_against_the_moved_cart(cell: ClinicalCell) -> None:
    engine = watched(cell)
    positioned(engine)
    before = cell.workcell.master.surroundings
    assert before is not None
    leave_by(cell, AWAY_MM)
    cell.arm.state = Lifecycle.ACTIVE
    with pytest.raises(BaseShifted), engine.checkpoint.watching("the next motion", MotionKind.GO):
        eventually(lambda: cell.arm.stops > 0)
    after = cell.workcell.master.surroundings
    assert after is not None
    ways = {
        one.name: np.subtract(other.capsule.start_mm, one.capsule.start_mm)
        for one, other in zip(before.obstacles, after.obstacles, strict=True)
    }
    assert ways["head"] == pytest.approx(np.negative(AWAY_MM), abs=1e-6)


def test_no_frame_within_reach_of_the_arms_report_is_taken_for_a_moved_cart() -> None:
    watch = TrackedCase(3).begin()
    here, way = (0.0, 0.0, 0.0), (100.0, 0.0, 0.0)  # the arm moved by 100 mm during one frame

    def off_mm(place_mm: Vector3, end_mm: Vector3) -> float | None:
        seen_mm = vector3(watch.robot_from_tracker.inverse().apply(place_mm))
        return watch.frame_off_arm_mm(seen_mm, here, end_mm)

    limit_mm = watch.gross_limit_mm
    assert off_mm((0.0, limit_mm - 0.1, 0.0), here) is None
    assert off_mm((0.0, limit_mm + 0.1, 0.0), here) == pytest.approx(limit_mm + 0.1)
    assert off_mm((50.0, 0.0, 0.0), way) is None
    assert off_mm((200.0, 0.0, 0.0), way) is None  # reported one frame late
    assert off_mm((230.0, 0.0, 0.0), way) == pytest.approx(130.0)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_plain_move_is_noticed_in_a_pose_that_was_never_seen_before(axis: int) -> None:
    case = TrackedCase(3)
    for share in (0.0, 1.2):
        watch = case.begin()
        cart_mm = share * watch.gross_limit_mm * np.eye(3)[axis]
        look = watch.compare(case.reading(watch, case.visits[0].at, cart_mm=cart_mm))
        assert isinstance(look.moved, BaseShifted) is (share > 1.0)


@pytest.mark.parametrize(("tool_mm", "limit_mm"), [(0.1, GROSS_LIMIT_MM), (2.0, 18.4)])
def test_a_tool_frame_that_is_not_measured_is_not_taken_for_a_moved_cart(
    tool_mm: float, limit_mm: float
) -> None:
    watch = TrackedCase(3).begin()
    arms = watch.estimate.model.arms
    sizes = replace(arms[Tracked.ARM].sizes, tool_mm=tool_mm)
    known = replace(watch.estimate.model, arms={Tracked.ARM: replace(arms[Tracked.ARM], sizes=sizes)})
    watch.estimate = replace(watch.estimate, model=known)
    assert watch.gross_limit_mm == pytest.approx(limit_mm, abs=0.1)


def test_a_sphere_lost_because_the_cart_left_is_no_reason_to_leave_it_out(cell: ClinicalCell) -> None:
    cell.carrying(MountedTool.STEREO_HEAD)
    before = (checked_paths(cell), *coarse(), checked_plan(), localized_fiducials())
    engine = cell.begin(*before, relocalization.STEP)
    engine.run_to(engine.order.sequence[4])

    def leave(_start: object, _target: object) -> bool:
        leave_by(cell, AWAY_MM)
        assert isinstance(cell.workcell, SeeingWorkcell)
        cell.workcell.spheres_mm = np.add(SPHERES_MM, (0.0, 200.0, 0.0))
        return False

    cell.arm.blocked = leave
    with pytest.raises(BaseShifted):
        engine.run_to()
    assert Topic.SPHERE not in [question.topic for question in cell.operator.asked]


def test_with_an_instrument_inside_nobody_is_asked_and_nothing_moves(cell: ClinicalCell) -> None:
    engine = watched(cell)
    engine.goes_on = MovedCart(engine).continues_by_consent
    positioned(engine)
    cell.workcell.master.instrument.record_insertion(FIRST)
    motions = list(cell.arm.motions)
    assert not engine.goes_on(BaseShifted("the cart of the robot was moved by 72.11 mm"))
    assert Topic.CART_MOVED not in [question.topic for question in cell.operator.asked]
    assert cell.arm.motions == motions
    assert "an instrument is or may be inside at T1. Nothing moves" in findings(cell)[-1]
