"""movec of URScript: the tool centre point on a circle, through one pose to another."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import atan2, hypot, pi

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
    first, middle, last = (np.array(point[:3]) for point in ((start.x, start.y, start.z), via, goal))
    normal = np.cross(middle - first, last - first)
    area = float(np.linalg.norm(normal))
    if not area > STRAIGHT:
        yield from movel(robot, goal, speed_m_s, acceleration_m_s2)
        return
    centre = first + _to_centre(middle - first, last - first)
    axis = normal / area
    along, across = first - centre, np.cross(axis, first - centre)
    angle = atan2(float(across @ (last - centre)), float(along @ (last - centre))) % (2.0 * pi)
    turn = rotation_vector(compose(end, inverted(start)))
    if keeps_turn:
        turn = tuple((angle * axis).tolist())

    def at(share: float) -> LinkPose:
        spun = compose(frame_of_pose((0.0, 0.0, 0.0, *(share * part for part in turn))), start)
        x, y, z = (centre + np.cos(share * angle) * along + np.sin(share * angle) * across).tolist()
        return spun._replace(x=x, y=y, z=z)

    length = max(angle * float(np.linalg.norm(along)), hypot(*turn) * TURN_PER_LENGTH)
    yield from follow_path(robot, at, length, speed_m_s, acceleration_m_s2)


def _to_centre(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Return the way to the centre of the circle through the origin and two points."""
    normal = np.cross(a, b)
    to_centre: np.ndarray = np.cross(normal, (a @ a) * b - (b @ b) * a) / (2.0 * (normal @ normal))
    return -to_centre
