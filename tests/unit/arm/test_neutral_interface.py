"""The neutral interface holds for both kinds of wrist and for seven axes, and planning works with all."""

from __future__ import annotations

import math
import random
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from calibrated_ur import CALIBRATED_UR
from coded_errors import raises
from monitored_motion import drive_monitored
from seven_axes import SevenAxisArm

from ronna_hw.arm import catalogue
from ronna_hw.arm.clearance.bodies import Bodies, Capsule, Obstacle, Part, Surroundings
from ronna_hw.arm.clearance.live_watch import LiveWatch, Violation
from ronna_hw.arm.errors import OutOfJointRange, Singular, Unreachable
from ronna_hw.arm.kinematics import Branch, Kinematics
from ronna_hw.arm.monitor import Monitor, monitor_limits
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import MotionPlan, plan_joint_move, plan_line
from ronna_hw.arm.motion.set_points import PathMotion
from ronna_hw.arm.pose import Pose, radians6
from ronna_hw.arm.universal_robots import universal_robot
from ronna_hw.devices.robot import LineMove
from ronna_hw.frames import FRAME_MISMATCH, Frame, Transform
from ronna_hw.preview import plan_motion, preview
from ronna_hw.vectors import JointVector, Vector3

ARMS = tuple(arm.kinematics for arm in catalogue.ARMS.values())


def _kr6_singular(elbow_offset_mm: float) -> dict[str, JointVector]:
    """By the data sheet: shoulder 25 mm ahead, upper arm 455 mm, forearm 420 mm."""
    stretched, A2 = math.atan2(elbow_offset_mm, 420.0), -1.8
    ahead_mm = 25.0 + 455.0 * math.cos(A2)
    under_A1 = stretched - A2 - math.acos(-ahead_mm / math.hypot(420.0, elbow_offset_mm))
    return {
        "wrist": radians6(10, -80, 100, 30, 0, 50),
        "elbow": (0.2, -1.0, stretched, 0.3, 0.5, 0.1),
        "shoulder": (0.2, A2, under_A1, 0.3, 0.5, 0.1),
    }


UR_SINGULAR = {
    "wrist": radians6(10, -80, -100, 30, 180, 50),
    "elbow": radians6(10, -80, 0, 30, 70, 50),
    "shoulder": radians6(10, -90, 0, 90, 70, 50),
}
SINGULAR = {
    "kr6_r900_sixx": _kr6_singular(35.0),
    "kr6_r900_2": _kr6_singular(25.0),
    **dict.fromkeys(("ur5", "ur5e", "ur3e", "ur10e", "ur16e"), UR_SINGULAR),
}
CYCLE_S = 0.004
TOOL = (Part("needle", Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 120.0), 3.0)),)
TIP_MM = (0.0, 0.0, 120.0)

each_arm = pytest.mark.parametrize("arm", ARMS, ids=lambda arm: arm.name)
each_chain = pytest.mark.parametrize(
    "arm",
    [*ARMS, CALIBRATED_UR, SevenAxisArm()],
    ids=[*(arm.name for arm in ARMS), "calibrated", "seven axes"],
)


def _postures(arm: Kinematics, count: int, seed: int) -> list[JointVector]:
    rng = random.Random(seed)
    ends = [*zip(arm.lower_rad, arm.upper_rad, strict=True)]
    return [tuple(rng.uniform(low, high) for low, high in ends) for _ in range(count)]


def _largest_difference(a: JointVector, b: JointVector) -> float:
    return max(abs(x - y) for x, y in zip(a, b, strict=True))


@pytest.mark.parametrize("postures", [120, pytest.param(1000, marks=pytest.mark.slow)])
@each_arm
def test_every_solution_reaches_the_pose_and_the_true_one_is_among_them(
    arm: Kinematics, postures: int
) -> None:
    seen: set[Branch] = set()
    for joints in _postures(arm, postures, 1):
        pose = arm.forward(joints)
        found = arm.solutions(pose)
        assert min(_largest_difference(one.joints_rad, joints) for one in found) < 1e-6
        firsts = {branch: angles for branch, angles in reversed(found)}
        for branch, angles in firsts.items():
            assert arm.branch_of(angles) == branch
            assert arm.forward(angles).distance_mm(pose) < 1e-6
            assert arm.forward(angles).angle_rad(pose) < 1e-8
        for _, angles in found:
            assert all(
                low - 1e-8 <= angle <= high + 1e-8
                for low, angle, high in zip(arm.lower_rad, angles, arm.upper_rad, strict=True)
            )
        seen.update(firsts)
    assert seen == set(arm.branches)


@each_arm
def test_solving_one_branch_returns_the_solution_nearest_to_the_reference(arm: Kinematics) -> None:
    for joints in _postures(arm, 300, 2):
        found = arm.solve_branch(arm.forward(joints), arm.branch_of(joints), joints)
        assert _largest_difference(found, joints) < 1e-6


@each_chain
def test_the_framed_pose_equals_the_plain_one(arm: Kinematics) -> None:
    pose = arm.flange_pose(arm.home_rad)
    assert (pose.target, pose.source) == (Frame.ROBOT, Frame.FLANGE)
    assert pose.translation_mm == pytest.approx(arm.forward(arm.home_rad).position_mm)


@each_chain
def test_the_jacobian_is_the_derivative_of_the_forward_kinematics(arm: Kinematics) -> None:
    step = 1e-6
    for joints in _postures(arm, 8, 3):
        analytic = arm.jacobian(joints)
        for axis in range(len(joints)):
            ends = [tuple(q + side * step * (k == axis) for k, q in enumerate(joints)) for side in (-1, 1)]
            before, after = (arm.flange_pose(one) for one in ends)
            moved = (after.translation_mm - before.translation_mm) / (2 * step)
            turned = (after.rigid.rotation * before.rigid.rotation.inv()).as_rotvec() / (2 * step)
            assert analytic[:3, axis] == pytest.approx(moved, abs=1e-3)
            assert analytic[3:, axis] == pytest.approx(turned, abs=1e-6)


@pytest.mark.hazard(22)
@each_arm
def test_singular_postures_measure_zero_and_have_no_solution(arm: Kinematics) -> None:
    for kind, joints in SINGULAR[arm.name].items():
        measure = arm.singular_measure(joints)
        assert getattr(measure, kind) == pytest.approx(0.0, abs=1e-9)
        assert measure.least < 1e-9
        with pytest.raises(Singular):
            arm.solve_branch(arm.forward(joints), arm.branch_of(joints), joints)
    assert 0.2 < arm.singular_measure(arm.home_rad).least <= 1.0


@each_chain
def test_a_pose_out_of_reach_is_refused_in_every_branch(arm: Kinematics) -> None:
    far = Pose((3000.0, 0.0, 500.0))
    with pytest.raises(Unreachable):
        arm.solutions(far)
    for branch in arm.branches:
        with pytest.raises(Unreachable):
            arm.solve_branch(far, branch, arm.home_rad)


@pytest.mark.parametrize(
    ("model", "outstretched_mm"),
    [("ur5", (-817.25, -191.45, -5.491)), ("ur5e", (-817.2, -232.9, 62.8))],
)
def test_the_offset_wrist_has_the_published_figures_and_two_to_eight_branches(
    model: str, outstretched_mm: Vector3
) -> None:
    arm = universal_robot(model)
    assert arm.forward((0.0,) * 6).position_mm == pytest.approx(outstretched_mm, abs=1e-9)
    counts = {
        len({branch for branch, _ in arm.solutions(arm.forward(joints))}) for joints in _postures(arm, 200, 4)
    }
    assert counts == {2, 4, 6, 8}


@each_chain
def test_a_joint_move_and_a_line_pass_the_monitor_and_end_at_their_targets(arm: Kinematics) -> None:
    start = arm.home_rad
    limits = working_limits(arm)
    away: JointVector = (start[0] + 0.3, start[1] - 0.1, *start[2:])
    end = arm.forward(away)
    x, y, z = end.position_mm
    target = Pose((x, y + 40.0, z - 30.0), end.rotation)
    assert _driven(arm, plan_joint_move(arm, start, away, limits)) == pytest.approx(away)
    line = plan_line(arm, away, target, limits, TIP_MM)
    assert arm.forward(_driven(arm, line)).distance_mm(target) < 1e-6
    path, begin = line.path(arm), end.apply(TIP_MM)
    for s in (0.25, 0.5, 0.75):
        on_line = [a + s * (b - a) for a, b in zip(begin, target.apply(TIP_MM), strict=True)]
        assert arm.forward(path.joints(s, away)).apply(TIP_MM) == pytest.approx(on_line, abs=1e-6)


def _driven(arm: Kinematics, plan: MotionPlan) -> JointVector:
    monitor = Monitor(monitor_limits(arm, working_limits(arm), CYCLE_S, plan.start_rad), plan.start_rad)
    monitor.watch(LiveWatch(Bodies(arm, Surroundings(tool=TOOL)), CYCLE_S, plan.start_rad))
    motion = PathMotion(plan.path(arm), plan.start_rad, plan.limits, CYCLE_S)
    assert isinstance(drive_monitored(motion, monitor), int)
    return monitor.last_rad


@each_chain
def test_range_errors_name_the_axis_as_the_arm_does(arm: Kinematics) -> None:
    beyond: JointVector = (*arm.home_rad[:-1], arm.upper_rad[-1] + 0.1)
    with pytest.raises(OutOfJointRange, match=f"ARM-003: {arm.axis_names[-1]} would leave its range"):
        plan_joint_move(arm, arm.home_rad, beyond, working_limits(arm))


@each_chain
def test_limits_are_of_as_many_axes_as_the_arm_has(arm: Kinematics) -> None:
    limits = working_limits(arm).with_reduced_speed(arm)
    assert len(limits.speed_rad_s) == len(arm.axis_names)
    assert [len(side) for side in limits.ranges(arm, arm.home_rad)] == 2 * [len(arm.axis_names)]


@each_chain
def test_the_monitor_trips_on_the_last_axis_and_on_an_obstacle_that_was_never_planned(
    arm: Kinematics,
) -> None:
    start, limits = arm.home_rad, working_limits(arm)
    monitor = Monitor(monitor_limits(arm, limits, CYCLE_S, start), start)
    leap: JointVector = (*start[:-1], start[-1] + 0.1)
    violation = monitor.check(leap)
    assert violation is not None
    assert (violation.kind, violation.axis) == ("speed", len(start))
    plan = plan_joint_move(arm, start, (start[0] + 0.6, *start[1:]), limits)
    tip = arm.forward((start[0] + 0.3, *start[1:])).apply(TIP_MM)
    post = Obstacle("post", Capsule(tip, (tip[0], tip[1], 0.0), 10.0))
    monitor.watch(LiveWatch(Bodies(arm, Surroundings(tool=TOOL, obstacles=(post,))), CYCLE_S, start))
    met = drive_monitored(PathMotion(plan.path(arm), start, plan.limits, CYCLE_S), monitor)
    assert isinstance(met, Violation)
    assert met.kind == "clearance"


@each_chain
def test_a_preview_detects_a_collision_of_the_tool_with_an_obstacle(arm: Kinematics) -> None:
    start, limits = arm.home_rad, working_limits(arm)
    away: JointVector = (start[0] + 0.6, *start[1:])
    plan = plan_joint_move(arm, start, away, limits)
    free = preview(arm, plan, Surroundings(tool=TOOL), limits)
    assert free.clear
    assert free.duration_s > 0.3
    halfway: JointVector = (start[0] + 0.3, *start[1:])
    tip = arm.forward(halfway).apply(TIP_MM)
    post = Obstacle("post", Capsule(tip, (tip[0], tip[1], 0.0), 10.0))
    met = preview(arm, plan, Surroundings(tool=TOOL, obstacles=(post,)), limits)
    assert met.refused is not None
    assert (met.refused.first, met.refused.second) == ("needle", "post")
    assert 0.3 < met.refused.fraction < 0.7


@each_chain
def test_the_chain_ends_at_the_flange(arm: Kinematics) -> None:
    for joints in _postures(arm, 20, 5):
        place, turn = np.array(arm.chain.base_mm), np.eye(3)
        for joint, angle in zip(arm.chain.joints, joints, strict=True):
            x, y, z = joint.axis
            cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
            turn = turn @ (np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross)
            place = place + turn @ joint.to_next_mm
        pose = arm.flange_pose(joints)
        assert place == pytest.approx(pose.translation_mm, abs=1e-8)
        flange = turn @ np.reshape(arm.chain.flange_rotation, (3, 3))
        assert np.allclose(flange, pose.rotation_matrix, atol=1e-10)


@each_chain
def test_links_are_ordered_from_the_base_outwards(arm: Kinematics) -> None:
    joints = [link.joint for link in arm.links]
    assert all(inner <= outer for inner, outer in pairwise(joints))
    segments, flange = arm.link_segments(arm.home_rad)
    assert len(segments) == len(arm.links)
    assert segments[-1][1] == pytest.approx(flange.position_mm)


@pytest.mark.parametrize("tool", [None, [0.0, 0.0, 0.1, 0.0, 0.0, 0.0]])
def test_a_controllers_pose_vector_is_no_pose(tool: Any) -> None:
    arm = universal_robot("ur5e")
    pose: Any = [0.4, 0.1, 0.3, 0.0, 3.14, 0.0]
    move = LineMove(
        Transform.of(Frame.ROBOT, Frame.TOOL, translation_mm=(400.0, 0.0, 300.0)) if tool else pose, tool
    )
    with raises(FRAME_MISMATCH, match=r"expected a Transform robot <- flange.*, got list"):
        plan_motion(arm, arm.home_rad, move, working_limits(arm))
