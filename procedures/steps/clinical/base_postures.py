"""Choice of postures for the bases of two arms: turns of each frame, and places of the assistant's ball."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import suppress

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from procedures.calibration.pose_set import PlannedLook, order_by_orientation, plan_poses_about
from procedures.workcell.assistant import Assistant
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector

Array = NDArray[np.float64]

FRAME_LOOKS, SPARE = 12, 12  # planned poses for each wanted one: an arm hides its own frame in most of them
MOST_FACING_RAD = math.radians(35.0)  # turn of the assistant's frame towards the tracker
FRAME_TILT_RAD, FRAME_TURN_RAD = math.radians(30.0), math.radians(60.0)
BALL_SPREAD_MM = np.array((60.0, 60.0, 50.0))  # either way, of the ball's places
PLACES_SEED = 49
BALL_TILT_RAD, BALL_TURN_RAD = math.radians(35.0), math.radians(60.0)
POSTURES = 6  # of the assistant with its ball
MOST_POSTURES = 48  # that are tried: an arm stands in the way of the other in many
FLANGE_ONWARDS = Rotation.from_matrix([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # instrument down


def plan_turns(reference: Rotation, place_mm: ArrayLike, frame_mm: ArrayLike) -> list[PlannedLook]:
    """Plan turns of a frame at a place; each set of `FRAME_LOOKS` is spread evenly and ordered by itself."""
    sets = (
        plan_poses_about(
            reference,
            place_mm,
            FRAME_LOOKS,
            number * FRAME_LOOKS,
            tilt_rad=FRAME_TILT_RAD,
            turn_rad=FRAME_TURN_RAD,
            offset_mm=frame_mm,
        )
        for number in range(SPARE)
    )
    return [look for one in sets for look in order_by_orientation(one)]


def turn_towards(facing: ArrayLike, wanted: ArrayLike) -> Rotation:
    """Return the turn of a direction (3,) towards another, by `MOST_FACING_RAD` at most."""
    one, other = (np.asarray(way, dtype=float) / np.linalg.norm(way) for way in (facing, wanted))
    axis = np.cross(one, other)
    sine = float(np.linalg.norm(axis))
    if not sine:
        return Rotation.identity()
    angle_rad = math.atan2(sine, float(one @ other))
    return Rotation.from_rotvec(axis / sine * min(angle_rad, MOST_FACING_RAD))


def plan_ball_postures(base: Transform, middle_mm: ArrayLike, ball_mm: ArrayLike) -> list[Transform]:
    """Plan poses of the assistant's flange, in its base, that hold the ball about a place of the robot frame.

    Each set of `POSTURES` is spread evenly and ordered by itself.
    """
    planned = [
        plan_poses_about(
            FLANGE_ONWARDS,
            base.inverse().apply(middle_mm + beside_mm),
            1,
            number,
            tilt_rad=BALL_TILT_RAD,
            turn_rad=BALL_TURN_RAD,
            offset_mm=ball_mm,
        )[0]
        for number, beside_mm in enumerate(spread_places(MOST_POSTURES))
    ]
    sets = (planned[first : first + POSTURES] for first in range(0, MOST_POSTURES, POSTURES))
    return [flange_of(posture.pose) for one in sets for posture in order_by_orientation(one)]


def spread_places(count: int) -> Array:
    """Return places (count, 3) spread about the middle: at one place, a turn of the base would not show."""
    draws = np.random.default_rng(PLACES_SEED)
    return np.asarray(draws.uniform(-1.0, 1.0, (count, 3)) * BALL_SPREAD_MM)


def working_joints(second: Assistant, flanges: Sequence[Transform]) -> JointVector:
    """Return joints in the branch in which the assistant reaches most of these poses of its flange."""
    one, two, three, four, five, six = second.home_rad

    def reached(near: JointVector) -> int:
        count = 0
        for flange in flanges:
            with suppress(LimitError):
                second.flange_joints(flange, near)
                count += 1
        return count

    return max((second.home_rad, (one, two, three, four, -five, six)), key=reached)


def flange_of(pose: Transform) -> Transform:
    """Return a planned pose as one of a flange."""
    return Transform(Frame.ROBOT, Frame.FLANGE, pose.rigid)
