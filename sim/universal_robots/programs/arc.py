"""movec of URScript: the tool centre point on a circle, through one pose to another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import atan2, hypot, inf, pi

import numpy as np

from sim.universal_robots.kinematics import LinkPose, compose, frame_of_pose, inverted, rotation_vector
from sim.universal_robots.programs.motions import TURN_PER_LENGTH, follow_path, movel, stopj
from sim.universal_robots.robot import Robot

STRAIGHT = 1e-9  # m2: twice the area of the triangle of the points, below which they lie on a line


def movec(
    robot: Robot,
    via: Sequence[float],
    goal: Sequence[float],
    speed_m_s: float,
    acceleration_m_s2: float,
    *,
    keeps_turn: bool,
) -> Iterator[None]:
    """Move on an arc; the tool turns evenly to that of the goal, or with the arc if it keeps its turn."""
    yield from stopj(robot, robot.parameters.program_stop_rad_s2)
    start, end = robot.tool_frame(robot.drives.target), frame_of_pose(goal)
    circle = _find_circle(np.array((start.x, start.y, start.z)), np.array(via[:3]), np.array(goal[:3]))
    if circle is None:
        yield from movel(robot, goal, speed_m_s, acceleration_m_s2)
        return
    centre, along, across, angle = circle
    axis = np.cross(along, across) / (along @ along)
    turn = rotation_vector(compose(end, inverted(start)))
    if keeps_turn:
        turn = tuple((angle * axis).tolist())

    def at(share: float) -> LinkPose:
        spun = compose(frame_of_pose((0.0, 0.0, 0.0, *(share * part for part in turn))), start)
        x, y, z = (centre + np.cos(share * angle) * along + np.sin(share * angle) * across).tolist()
        return spun._replace(x=x, y=y, z=z)

    length = max(angle * float(np.linalg.norm(along)), hypot(*turn) * TURN_PER_LENGTH)
    yield from follow_path(robot, at, length, speed_m_s, acceleration_m_s2)


def _find_circle(
    first: np.ndarray, via: np.ndarray, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float] | None:
    """Return centre, radii to the first point and across, and angle of the arc; None for a straight line."""
    a, b = via - first, last - first
    with np.errstate(over="ignore", invalid="ignore"):  # a client may send any numbers
        normal = np.cross(a, b)
        area = float(np.linalg.norm(normal))
        if not STRAIGHT < area < inf:
            return None
        along = np.cross(normal, (a @ a) * b - (b @ b) * a) / (2.0 * area**2)
        across = np.cross(normal / area, along)
    angle = atan2(float(across @ (b + along)), float(along @ (b + along))) % (2.0 * pi)
    return first - along, along, across, angle
