"""Choice of postures for the bases of two arms: turns of each frame, and places of the assistant's ball."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from procedures.calibration.pose_set import PlannedLook, plan_poses_about
from procedures.workcell.assistant import Assistant
from ronna_hw.arrays import Array
from ronna_hw.errors import LimitError
from ronna_hw.frames import Frame, Transform
from ronna_hw.vectors import JointVector

FRAME_LOOKS, SPARE = 8, 18  # planned poses for each wanted one: an arm hides its own frame in most of them
MOST_FACING_RAD = math.radians(35.0)  # turn of the assistant's frame towards the tracker
FRAME_TILT_RAD, FRAME_TURN_RAD = math.radians(30.0), math.radians(60.0)
BALL_SPREAD_MM = np.array((40.0, 40.0, 60.0))  # either way, of the ball's places
PLACES_SEED = 49
# Close to the posture with the instrument: what the arms err there is part of the bases, the ways are short.
BALL_TILT_RAD, BALL_TURN_RAD = math.radians(20.0), math.radians(30.0)
POSTURES = 8  # of the assistant with its ball
MOST_POSTURES = 48  # that are tried: an arm stands in the way of the other in many
TURN_STEP_RAD = math.radians(15.0)  # about the axis of an instrument
OUT_OF_REACH_RAD = 2.0 * math.pi  # a pose out of reach counts as a way as long
FLANGE_ONWARDS = Rotation.from_matrix([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # instrument down


def plan_turns(reference: Rotation, place_mm: ArrayLike, frame_mm: ArrayLike) -> tuple[PlannedLook, ...]:
    """Plan turns of a frame at a place; the first ones of any number are spread evenly."""
    return plan_poses_about(
        reference,
        place_mm,
        FRAME_LOOKS * SPARE,
        tilt_rad=FRAME_TILT_RAD,
        turn_rad=FRAME_TURN_RAD,
        offset_mm=frame_mm,
    )


def turn_towards(facing: ArrayLike, wanted: ArrayLike, most_rad: float = MOST_FACING_RAD) -> Rotation:
    """Return the turn of a direction (3,) towards another, by `most_rad` at most."""
    one, other = (np.asarray(way, dtype=float) / np.linalg.norm(way) for way in (facing, wanted))
    axis = np.cross(one, other)
    angle_rad = math.atan2(float(np.linalg.norm(axis)), float(one @ other))
    if not axis.any():  # opposite directions are turned into each other about any axis across them
        axis = np.cross(one, np.eye(3)[np.argmin(np.abs(one))])
    return Rotation.from_rotvec(axis / np.linalg.norm(axis) * min(angle_rad, most_rad))


def face_along(instrument: ArrayLike, inwards: ArrayLike) -> Rotation:
    """Return the flange with the instrument along an axis, turned least from `FLANGE_ONWARDS`.

    `instrument` (3,) is its direction in the flange frame, `inwards` (3,) that of the axis in the base.
    """
    held, wanted = FLANGE_ONWARDS.apply(instrument), np.asarray(inwards, dtype=float)
    return turn_towards(held, wanted, math.pi) * FLANGE_ONWARDS


def plan_ball_postures(
    reference: Rotation, base: Transform, middle_mm: ArrayLike, ball_mm: ArrayLike
) -> list[Transform]:
    """Plan poses of the assistant's flange, in its base, that hold the ball about a place of the robot frame.

    They are turned about `reference`, in which it will hold the instrument.
    """
    return [
        flange_of(
            plan_poses_about(
                reference,
                base.inverse().apply(middle_mm + beside_mm),
                1,
                number,
                tilt_rad=BALL_TILT_RAD,
                turn_rad=BALL_TURN_RAD,
                offset_mm=ball_mm,
            )[0].pose
        )
        for number, beside_mm in enumerate(spread_places(MOST_POSTURES))
    ]


def spread_places(count: int) -> Array:
    """Return places (count, 3) spread about the middle: at one place, a turn of the base would not show."""
    draws = np.random.default_rng(PLACES_SEED)
    return np.asarray(draws.uniform(-1.0, 1.0, (count, 3)) * BALL_SPREAD_MM)


def working_joints(assistant: Assistant, flanges: Sequence[Transform]) -> JointVector:
    """Return joints in the branch in which the assistant reaches these poses of its flange by short ways.

    In the other one, its wrist turns by whole turns where a joint comes to the end of its range.
    """

    def way_rad(near: JointVector) -> float:
        way = 0.0
        for flange in flanges:
            try:
                way += travel_rad(assistant.flange_joints(flange, near), assistant.home_rad)
            except LimitError:
                way += OUT_OF_REACH_RAD
        return way

    return min(wrist_branches(assistant), key=way_rad)


def turns_about_axis(clamp: Rotation) -> list[Rotation]:
    """Return a clamp turned about the axis of its instrument: the bore leaves that free."""
    steps = range(round(2.0 * math.pi / TURN_STEP_RAD))
    return [clamp * Rotation.from_rotvec([0.0, 0.0, step * TURN_STEP_RAD]) for step in steps]


def wrist_branches(assistant: Assistant) -> tuple[JointVector, JointVector]:
    """Return joints in both branches of the wrist, of which each pose leaves the choice."""
    *inner, bend, turn = assistant.home_rad
    return assistant.home_rad, (*inner, -bend, turn)


def travel_rad(start_rad: JointVector, end_rad: JointVector) -> float:
    """Return by how much the joint turns that turns most: it decides how long a motion takes."""
    return max(abs(end - start) for start, end in zip(start_rad, end_rad, strict=True))


def order_by_travel(start_rad: JointVector, postures: Sequence[JointVector]) -> list[JointVector]:
    """Sort postures so that each is the one nearest to the previous one."""
    here_rad, left, ordered = start_rad, list(postures), []
    while left:
        here_rad = min(left, key=partial(travel_rad, here_rad))
        left.remove(here_rad)
        ordered.append(here_rad)
    return ordered


def flange_of(pose: Transform) -> Transform:
    """Return a planned pose as one of the assistant's flange."""
    return Transform(Frame.ASSISTANT, Frame.FLANGE, pose.rigid)
