"""The driver checks every motion against its surroundings, before the start and in the real-time process."""

from __future__ import annotations

from dataclasses import replace
from math import degrees, radians
from typing import Any

import pytest

from drivers.kuka_rsi.errors import STREAM_ERRORS
from drivers.kuka_rsi.fault_errors import RsiFaults
from drivers.kuka_rsi.options import KukaOptions
from ronna_hw.arm.clearance.bodies import Bodies, Capsule, Obstacle, Surroundings
from ronna_hw.arm.clearance.live_watch import ViolationKind
from ronna_hw.arm.errors import NotClear, Singular, Unreachable
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import plan_joint_move
from ronna_hw.arm.pose import radians6
from ronna_hw.arm_stream.records import NO_STATE, Choice, LinkFault
from ronna_hw.arm_stream.set_points import SetPoints
from ronna_hw.devices import JointMove, Lifecycle, LineMove
from ronna_hw.frames import Frame, Transform
from ronna_hw.wire.kuka_eki import OperationMode

MODEL = kr6_r900("kr6_r900_sixx")
START = radians6(0.0, -90.0, 90.0, 0.0, 60.0, 0.0)
ASIDE = radians6(20.0, -90.0, 90.0, 0.0, 60.0, 0.0)
CYCLE_S = 0.004


def _post_beside(angle_deg: float) -> Surroundings:
    """Place a ball where the flange comes past when A1 stands at that angle."""
    place = MODEL.forward(radians6(angle_deg, -90.0, 90.0, 0.0, 60.0, 0.0)).position_mm
    return Surroundings(obstacles=(Obstacle("drip stand", Capsule(place, place, 20.0)),))


@pytest.mark.hazard(24)
def test_an_obstructed_goal_is_refused_before_motion(controller: Any, active_arm: Any) -> None:
    active_arm.surround(_post_beside(15.0))
    sent = controller.replies[-1][1]
    with pytest.raises(NotClear, match=r"ARM-007: .*hand would come too close to the drip stand") as caught:
        active_arm.move(JointMove(ASIDE))
    assert "\n" not in str(caught.value)
    assert active_arm.state is Lifecycle.ACTIVE
    assert controller.replies[-1][1] == sent
    active_arm.surround(Surroundings())
    assert active_arm.move(JointMove(ASIDE)).joints_rad[0] == pytest.approx(radians(20.0), abs=1e-4)


@pytest.mark.hazard(24)
def test_a_preview_shows_whether_a_motion_is_clear_and_nothing_moves(
    controller: Any, active_arm: Any
) -> None:
    sent = controller.replies[-1][1]
    active_arm.surround(_post_beside(15.0))
    seen = active_arm.preview(JointMove(ASIDE))
    assert not seen.clear
    assert (seen.refused.first, seen.refused.second) == ("hand", "drip stand")
    active_arm.surround(Surroundings())
    seen = active_arm.preview(JointMove(ASIDE))
    assert seen.clear
    assert seen.duration_s > 0.3
    assert seen.joint_ranges_rad[0] == pytest.approx((0.0, radians(20.0)), abs=1e-3)
    assert 0.0 < seen.singularity.least <= 1.0
    with pytest.raises(Singular, match="ARM-002"):
        active_arm.preview(LineMove(MODEL.flange_pose(radians6(0.0, -90.0, 90.0, 0.0, 0.0, 0.0))))
    assert controller.replies[-1][1] == sent


def test_a_preview_needs_no_stream(make_arm: Any) -> None:
    arm = make_arm()
    arm.connect()
    assert arm.preview(JointMove(ASIDE)).clear


@pytest.mark.hazard(22)
@pytest.mark.hazard(23)
def test_unreachable_and_singular_goals_are_refused_before_motion(controller: Any, active_arm: Any) -> None:
    sent = controller.replies[-1][1]
    with pytest.raises(Unreachable, match="ARM-001"):
        active_arm.move(
            LineMove(Transform.of(Frame.ROBOT, Frame.FLANGE, translation_mm=(2000.0, 0.0, 500.0)))
        )
    with pytest.raises(Singular, match="ARM-002"):
        active_arm.move(LineMove(MODEL.flange_pose(radians6(0.0, -90.0, 90.0, 0.0, 0.0, 0.0))))
    assert active_arm.state is Lifecycle.ACTIVE
    assert controller.replies[-1][1] == sent


@pytest.mark.hazard(24)
def test_the_real_time_process_trips_on_an_obstacle_that_planning_missed() -> None:
    """Planned without the post, driven with it: as if planning were wrong."""
    limits = working_limits(MODEL)
    points = SetPoints(MODEL, limits, CYCLE_S, START)
    points.start(plan_joint_move(MODEL, START, ASIDE, limits), 1.0, _post_beside(15.0))
    points.prepare()
    while points.moving and points.violation is None:
        points.commit(Choice.GO)
        points.prepare()
    assert points.violation is not None
    assert points.violation.kind == ViolationKind.CLEARANCE
    before = points.last_rad[0]
    while points.moving:
        points.commit(Choice.STOP)
        points.prepare()
    assert radians(1.0) < before <= points.last_rad[0] < radians(15.0)


def _fault(kind: str, axis: int, value: float, limit: float, mode: OperationMode = OperationMode.EXT) -> Any:
    state = replace(
        NO_STATE,
        fault=LinkFault.MONITOR,
        violation_kind=kind,
        violation_axis=axis,
        violation_value=value,
        violation_limit=limit,
    )
    return RsiFaults("master", MODEL, STREAM_ERRORS, KukaOptions()).error(state, mode, _post_beside(15.0))


def test_a_trip_names_the_two_bodies_and_the_distance() -> None:
    bodies = Bodies(MODEL, _post_beside(15.0))
    pair = next(k for k, one in enumerate(bodies.pairs) if bodies.names(one) == ("hand", "drip stand"))
    error = _fault(ViolationKind.CLEARANCE, pair, 4.2, 5.0)
    assert error.code == STREAM_ERRORS.tripped.code
    assert "clearance of hand and drip stand" in str(error)
    assert (error.limit, error.got) == ("5.0 mm", "4.2 mm")
    assert _fault(ViolationKind.ZONE_SPEED, pair, 80.0, 60.0).got == "80.0 mm/s"
    assert "its bodies" in str(_fault(ViolationKind.CLEARANCE, 255, 4.2, 5.0))


@pytest.mark.hazard(51)
def test_a_trip_names_the_limit_and_the_mode() -> None:
    tenth = 0.1 * MODEL.full_speed_rad_s[3]
    error = _fault(ViolationKind.SPEED, 4, 1.9 * tenth, tenth, OperationMode.T1)
    assert "speed of A4" in str(error)
    assert error.limit == f"{degrees(tenth):.1f} deg/s (10% of full speed in T1)"
    assert error.got == f"{degrees(1.9 * tenth):.1f} deg/s"
    hand = Bodies(MODEL, _post_beside(15.0)).moving_names.index("hand")
    error = _fault(ViolationKind.BODY_SPEED, hand, 301.0, 250.0, OperationMode.T1)
    assert "speed of the hand" in str(error)
    assert "head" not in str(error)
    assert (error.limit, error.got) == ("250.0 mm/s in T1", "301.0 mm/s")
