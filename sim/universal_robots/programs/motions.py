"""Motions of URScript: movej, movel, speedj, speedl, stopj. Each step is a cycle."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from math import hypot, inf

import numpy as np

from sim.universal_robots.kinematics import LinkPose, compose, frame_of_pose, inverted, rotation_vector
from sim.universal_robots.model import JOINT_RANGE_RAD, JOINTS, LARGEST_ACCELERATION_RAD_S2
from sim.universal_robots.robot import Robot
from sim.world.trapezoid import Trapezoid

SMALLEST_PATH = 1e-9  # rad or m below which there is nothing to do
LEAST_SPEED, LEAST_ACCELERATION = 1e-3, 1e-2  # of a motion that is asked for without
TURN_PER_LENGTH = 1.0  # rad: a turn counts like as many metres on a path
SINGULAR_DAMPING = 1e-6
MOST_ATTEMPTS, SLACK = 8, 1.01  # to find a step that the joints can follow


def _shares(robot: Robot, profile: Trapezoid) -> Iterator[float]:
    """Yield the fraction of a path once per cycle, slowed by the speed slider, ending at 1."""
    time_s = 0.0
    while time_s < profile.duration_s:
        time_s += robot.cycle_s * robot.speed_fraction
        yield profile.share(time_s)


def movej(
    robot: Robot, goal_rad: Sequence[float], speed_rad_s: float, acceleration_rad_s2: float
) -> Iterator[None]:
    """Move all joints in proportion; speed and acceleration are those of the leading one.

    Raises ValueError for a goal beyond the range of a joint.
    """
    for number, angle in enumerate(goal_rad):
        if abs(angle) > JOINT_RANGE_RAD:
            raise ValueError(f"movej: joint {number} cannot reach {angle:.2f} rad")
    yield from stopj(robot, robot.parameters.program_stop_rad_s2)
    start = robot.drives.target
    travel = [goal - angle for goal, angle in zip(goal_rad, start, strict=True)]
    length = max(map(abs, travel))
    if length < SMALLEST_PATH:
        return
    full = (
        most * (length / abs(way))
        for most, way in zip(robot.model.full_speed_rad_s, travel, strict=True)
        if way
    )
    speed = max(LEAST_SPEED, min(speed_rad_s, *full))
    acceleration = max(LEAST_ACCELERATION, min(acceleration_rad_s2, LARGEST_ACCELERATION_RAD_S2))
    for share in _shares(robot, Trapezoid(length, speed, acceleration)):
        if share == 1.0:
            robot.drives.place(list(goal_rad))
        else:
            robot.drives.place([angle + share * way for angle, way in zip(start, travel, strict=True)])
        yield


def movel(
    robot: Robot,
    pose: Sequence[float],
    speed_m_s: float,
    acceleration_m_s2: float,
    *,
    waits_for_joints: bool = False,
) -> Iterator[None]:
    """Move the tool centre point straight."""
    yield from stopj(robot, robot.parameters.program_stop_rad_s2)
    start, goal = robot.tool_frame(robot.drives.target), frame_of_pose(pose)
    turn = rotation_vector(compose(goal, inverted(start)))
    way = (goal.x - start.x, goal.y - start.y, goal.z - start.z)

    def at(share: float) -> LinkPose:
        spun = compose(frame_of_pose((0.0, 0.0, 0.0, *(share * angle for angle in turn))), start)
        x, y, z = (a + share * b for a, b in zip((start.x, start.y, start.z), way, strict=True))
        return spun._replace(x=x, y=y, z=z)

    length = max(hypot(*way), hypot(*turn) * TURN_PER_LENGTH)
    yield from follow_path(robot, at, length, speed_m_s, acceleration_m_s2, waits_for_joints=waits_for_joints)


def follow_path(
    robot: Robot,
    at: Callable[[float], LinkPose],
    length: float,
    speed_m_s: float,
    acceleration_m_s2: float,
    *,
    waits_for_joints: bool = False,
) -> Iterator[None]:
    """Move the tool centre point on a path of shares 0 to 1.

    If the joints cannot follow, it asks for a protective stop; on a path that waits for them it slows down.
    """
    if length < SMALLEST_PATH:
        return
    profile = Trapezoid(length, max(LEAST_SPEED, speed_m_s), max(LEAST_ACCELERATION, acceleration_m_s2))
    time_s = 0.0
    while time_s < profile.duration_s:
        step_s = robot.cycle_s * robot.speed_fraction
        for _ in range(MOST_ATTEMPTS if waits_for_joints else 1):
            joints = robot.joints_at(at(profile.share(time_s + step_s)), robot.drives.target)
            excess = inf if joints is None else _excess(robot, joints)
            if excess <= 1.0 or joints is None:
                break
            step_s /= excess * SLACK
        if joints is None or excess > 1.0:
            robot.stop_request = "the joints cannot follow the tool on its path"
            yield
            return
        time_s += step_s
        robot.drives.place(joints)
        yield


def _excess(robot: Robot, joints_rad: Sequence[float]) -> float:
    """Return the speed that the fastest joint would need, as a multiple of its full speed."""
    steps = zip(joints_rad, robot.drives.target, robot.model.full_speed_rad_s, strict=True)
    return max(abs(new - old) / (most * robot.cycle_s) for new, old, most in steps)


def speedj(robot: Robot, speeds_rad_s: Sequence[float], acceleration_rad_s2: float) -> None:
    """Approach joint speeds for one cycle."""
    fraction = robot.speed_fraction
    robot.drives.speed([fraction * speed for speed in speeds_rad_s], acceleration_rad_s2)


def speedl(robot: Robot, velocity: Sequence[float], acceleration_m_s2: float) -> None:
    """Approach a velocity of the tool centre point, m/s and rad/s in the base, for one cycle."""
    jacobian = robot.kinematics.jacobian(robot.drives.target, robot.tcp)
    normal = jacobian.T @ jacobian + SINGULAR_DAMPING * np.eye(JOINTS)
    with np.errstate(over="ignore", invalid="ignore"):  # the drives refuse a speed that is no number
        speeds = np.linalg.solve(normal, jacobian.T @ np.array(velocity) * robot.speed_fraction)
    most = float(np.abs(speeds).max()) / max(hypot(*velocity), SMALLEST_PATH)
    acceleration = min(LARGEST_ACCELERATION_RAD_S2, max(1.0, acceleration_m_s2 * most))
    robot.drives.speed(speeds.tolist(), acceleration)


def stopj(robot: Robot, deceleration_rad_s2: float) -> Iterator[None]:
    """Come to rest, the leading joint with that deceleration."""
    deceleration = max(LEAST_ACCELERATION, deceleration_rad_s2)
    while robot.drives.moving:
        robot.drives.brake(deceleration)
        yield
