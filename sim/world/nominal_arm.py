"""Nominal KR 6 R900: machine data, KUKA frames, and closed-form postures.

Written from the published robot descriptions of both arms that share the name, independently of the
kinematics that the drivers use. The wrist root is where A4, A5 and A6 intersect: A1 to A3 position it, A4 to
A6 rotate the flange about it. Status S and turn T of an E6POS select one of several postures for a pose.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import acos, atan2, cos, degrees, hypot, pi, radians, sin
from typing import NamedTuple

import numpy as np

from ronna_hw.arm.catalogue import KUKA
from sim.errors import BAD_SCENE
from sim.world.rigid import Matrix, Point, rotation_from_vector

AXES = 6
ORIGIN = (0.0, 0.0, 0.0)
FLANGE_PITCH_DEG = 90.0  # the flange frame is the last link turned about its y: z points out of the flange


GIMBAL_LIMIT = 1e-9  # cosine of B below which only A - C or A + C is defined
OVERHEAD, ABOVE_STRETCH, WRIST_NOT_POSITIVE = 1, 2, 4  # bits of the status
# Postures of a procedure; the wrist's two are equivalent, its ranges being symmetric.
POSTURES = (ABOVE_STRETCH, 0, OVERHEAD | ABOVE_STRETCH, OVERHEAD)
STRAIGHT_WRIST = 1e-6  # sine of A5 below which only A4 + A6 is defined
ZERO_DEG = 0.01  # a frame with four decimals does not show on which side of zero its axes were


@dataclass(frozen=True)
class NominalJoint:
    """A revolute joint at `origin_mm` in the previous joint's frame."""

    name: str
    origin_mm: tuple[float, float, float]
    axis: tuple[float, float, float]
    lower_deg: float
    upper_deg: float
    full_speed_deg_s: float
    acceleration_deg_s2: float


class Corner(NamedTuple):
    """Corner of the arm's body in the frame of a joint; the tube from it to the next one has a radius."""

    joint: int
    offset_mm: tuple[float, float, float]
    radius_mm: float


class LinkWeight(NamedTuple):
    """Weight of a link; its centre is given with the arm at zero, in the base."""

    mass_kg: float
    centre_mm: Point


@dataclass(frozen=True)
class ArmMake:
    """Make of arms: its name, the word for its controller in fault scripts, and their inverse.

    `postures` are those of a procedure, the usual one first. `axes` gives the joint angles (rad, modulo whole
    turns) for a flange pose (4, 4) in the robot's base in one of the postures, or None out of reach; the ends
    of the joints' ranges are not checked.
    """

    name: str
    in_faults: str
    postures: tuple[int, ...]
    axes: Callable[[RobotDescription, Matrix, int], Sequence[float] | None]
    senses_force: bool = False  # by itself, without a sensor on its flange


@dataclass(frozen=True)
class RobotDescription:
    """Machine data of an arm, with its controller name `variant` and the `model` its controller states.

    `flange_mm` and `flange_turn_rad` place the flange in the frame of the last joint; `upper_arm_mm` and
    `forearm_mm` are the lengths by which gravity bends shoulder and elbow. The last of `corners`, which make
    the body that hides things from a tracker, is connected to the flange. `links` are empty where the
    controller has them.
    """

    make: ArmMake
    variant: str
    model: str
    joints: tuple[NominalJoint, ...]
    flange_mm: tuple[float, float, float]
    flange_turn_rad: tuple[float, float, float]  # rotation vector
    upper_arm_mm: float
    forearm_mm: float
    corners: tuple[Corner, ...]
    links: tuple[LinkWeight, ...] = ()

    @property
    def stretched_A3_deg(self) -> float:
        """A3 angle in degrees that aligns the upper arm with the wrist root."""
        return degrees(atan2(self.joints[3].origin_mm[2], self.joints[4].origin_mm[0]))


def frame_of(pose: Matrix) -> list[float]:
    """Return X Y Z (mm) A B C (deg) of a pose (4, 4), R = Rz(A) Ry(B) Rx(C); A is 0 at B = 90 deg."""
    r00, _, _, x, r10, r11, r12, y, r20, r21, r22, z = pose[:3].ravel().tolist()
    cosine_B = (r00 * r00 + r10 * r10) ** 0.5
    if cosine_B < GIMBAL_LIMIT:
        B = 90.0 if r20 < 0 else -90.0
        # With A = 0 the second column is (0, cos C, -sin C) in the rotated frame.
        return [x, y, z, 0.0, B, degrees(atan2(-r12, r11)) + 0.0]
    return [x, y, z, degrees(atan2(r10, r00)), degrees(atan2(-r20, cosine_B)), degrees(atan2(r21, r22))]


def pose_of_frame(frame: Sequence[float]) -> Matrix:
    """Convert a frame X Y Z (mm) A B C (deg) to a pose (4, 4)."""
    x, y, z, A, B, C = frame
    ca, sa = cos(radians(A)), sin(radians(A))
    cb, sb = cos(radians(B)), sin(radians(B))
    cc, sc = cos(radians(C)), sin(radians(C))
    return np.array(
        [
            [ca * cb, ca * sb * sc - sa * cc, ca * sb * cc + sa * sc, x],
            [sa * cb, sa * sb * sc + ca * cc, sa * sb * cc - ca * sc, y],
            [-sb, cb * sc, cb * cc, z],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def status_and_turn(arm: RobotDescription, axes_deg: Sequence[float]) -> tuple[int, int]:
    """Return the status S and turn T of a posture.

    Bits of S: wrist root behind A1, A3 beyond the stretched arm, A5 not positive.
    """
    A2, A3, A5 = axes_deg[1], axes_deg[2], axes_deg[4]
    shoulder_mm = arm.joints[1].origin_mm[0]
    upper_mm = arm.joints[2].origin_mm[0]
    elbow_mm = arm.joints[3].origin_mm[2]
    forearm_mm = arm.joints[4].origin_mm[0]
    fore = radians(A2 + A3)
    ahead_mm = shoulder_mm + upper_mm * cos(radians(A2)) + forearm_mm * cos(fore) + elbow_mm * sin(fore)
    status = OVERHEAD if ahead_mm < 0 else 0
    if arm.stretched_A3_deg <= A3:
        status |= ABOVE_STRETCH
    if A5 <= 0:
        status |= WRIST_NOT_POSITIVE
    turn = sum(1 << number for number, angle in enumerate(axes_deg) if angle < 0)
    return status, turn


def axes_of_posture(
    arm: RobotDescription, flange: Matrix, status: int, turn: int, near_deg: Sequence[float]
) -> list[float] | None:
    """Return the axes (deg) for a flange pose (4, 4) in $ROBROOT with posture S T, or None if impossible.

    None if the pose is out of reach, or an axis of that turn is beyond its end switch. `near_deg` decides A4
    if the wrist is straight.
    """
    angles = axes_of_status(arm, flange, status, radians(near_deg[3]))
    if angles is None:
        return None
    axes = []
    for number, (joint, angle) in enumerate(zip(arm.joints, angles, strict=True)):
        value = _with_sign((degrees(angle) + 180.0) % 360.0 - 180.0, bool(turn & 1 << number))
        if not joint.lower_deg <= value <= joint.upper_deg:
            return None
        axes.append(value)
    return axes


def axes_of_status(
    arm: RobotDescription, flange: Matrix, status: int, near_A4: float = 0.0
) -> tuple[float, float, float, float, float, float] | None:
    """Return the axes (rad, modulo whole turns) for a flange pose (4, 4) in $ROBROOT with status S.

    None if the pose is out of reach; end switches are not checked. `near_A4` decides A4 if the wrist is
    straight.
    """
    joints = arm.joints
    rotation = flange[:3, :3] @ rotation_from_vector((0.0, -radians(FLANGE_PITCH_DEG), 0.0))
    x, y, z = (flange[:3, 3] - joints[5].origin_mm[0] * rotation[:, 0]).tolist()
    overhead = bool(status & OVERHEAD)
    A1 = -atan2(y, x) + (pi if overhead else 0.0)
    out_mm = (-hypot(x, y) if overhead else hypot(x, y)) - joints[1].origin_mm[0]
    down_mm = joints[0].origin_mm[2] - z
    upper_mm = joints[2].origin_mm[0]
    fore_mm = hypot(joints[4].origin_mm[0], joints[3].origin_mm[2])
    cosine = (out_mm**2 + down_mm**2 - upper_mm**2 - fore_mm**2) / (2.0 * upper_mm * fore_mm)
    if abs(cosine) > 1.0:
        return None
    bend = acos(cosine) if status & ABOVE_STRETCH else -acos(cosine)
    A3 = radians(arm.stretched_A3_deg) + bend
    A2 = atan2(down_mm, out_mm) - atan2(fore_mm * sin(bend), upper_mm + fore_mm * cos(bend))
    wrist = rotation_from_vector((0.0, 0.0, -A1)).T @ rotation
    wrist = rotation_from_vector((0.0, -(A2 + A3), 0.0)) @ wrist
    A4, A5, A6 = _solve_wrist(wrist, bool(status & WRIST_NOT_POSITIVE), near_A4)
    return A1, A2, A3, A4, A5, A6


def _solve_wrist(wrist: Matrix, not_positive: bool, near_A4: float) -> tuple[float, float, float]:
    """Solve Rx(-A4) Ry(A5) Rx(-A6) for A4, A5 and A6 (rad)."""
    sine = hypot(wrist[1, 0], wrist[2, 0])
    if sine < STRAIGHT_WRIST:
        both = atan2(-wrist[2, 1], wrist[1, 1])
        return near_A4, 0.0, both - near_A4
    sign = -1.0 if not_positive else 1.0
    A4 = atan2(-sign * wrist[1, 0], -sign * wrist[2, 0])
    A6 = atan2(-sign * wrist[0, 1], sign * wrist[0, 2])
    return A4, sign * atan2(sine, wrist[0, 0]), A6


def _with_sign(angle_deg: float, negative: bool) -> float:
    """Add a whole turn if needed for the required sign, which zero always satisfies."""
    if abs(angle_deg) < ZERO_DEG:
        return angle_deg
    if negative and angle_deg >= 0.0:
        return angle_deg - 360.0
    if not negative and angle_deg < 0.0:
        return angle_deg + 360.0
    return angle_deg


# Planner accelerations in rad/s2, published for the sixx; the -2 has none, so it uses the same.
_ACCELERATION = tuple(degrees(value) for value in (21.67, 6.89, 31.42, 133.1, 135.6, 268.4))


def _build_joints(
    elbow_mm: float, flange_mm: float, wrist_speeds_deg_s: tuple[float, float, float]
) -> tuple[NominalJoint, ...]:
    fourth, fifth, sixth = wrist_speeds_deg_s
    a = _ACCELERATION
    return (
        NominalJoint("A1", (0.0, 0.0, 400.0), (0.0, 0.0, -1.0), -170.0, 170.0, 360.0, a[0]),
        NominalJoint("A2", (25.0, 0.0, 0.0), (0.0, 1.0, 0.0), -190.0, 45.0, 300.0, a[1]),
        NominalJoint("A3", (455.0, 0.0, 0.0), (0.0, 1.0, 0.0), -120.0, 156.0, 360.0, a[2]),
        NominalJoint("A4", (0.0, 0.0, elbow_mm), (-1.0, 0.0, 0.0), -185.0, 185.0, fourth, a[3]),
        NominalJoint("A5", (420.0, 0.0, 0.0), (0.0, 1.0, 0.0), -120.0, 120.0, fifth, a[4]),
        NominalJoint("A6", (flange_mm, 0.0, 0.0), (-1.0, 0.0, 0.0), -350.0, 350.0, sixth, a[5]),
    )


def _weigh(elbow_mm: float, flange_mm: float) -> tuple[LinkWeight, ...]:
    """Return the links of a KR 6 R900, stretched out along x: 34 of its 52 kg, the base has the rest.

    Weights are estimates (U): nobody publishes them.
    """
    level_mm = 400.0 + elbow_mm
    return (
        LinkWeight(12.0, (10.0, 0.0, 330.0)),
        LinkWeight(9.0, (220.0, 0.0, 400.0)),
        LinkWeight(8.0, (530.0, 0.0, 420.0)),
        LinkWeight(3.5, (710.0, 0.0, level_mm)),
        LinkWeight(1.5, (920.0, 0.0, level_mm)),
        LinkWeight(0.15, (890.0 + flange_mm, 0.0, level_mm)),
    )


def _describe(
    variant: str,
    model: str,
    elbow_mm: float,
    flange_mm: float,
    wrist_speeds_deg_s: tuple[float, float, float],
) -> RobotDescription:
    joints = _build_joints(elbow_mm, flange_mm, wrist_speeds_deg_s)
    return RobotDescription(
        _MAKE,
        variant,
        model,
        joints,
        flange_mm=ORIGIN,
        flange_turn_rad=(0.0, radians(FLANGE_PITCH_DEG), 0.0),
        upper_arm_mm=joints[2].origin_mm[0],
        forearm_mm=joints[4].origin_mm[0],
        corners=(Corner(1, ORIGIN, 90.0), Corner(2, ORIGIN, 55.0), Corner(4, ORIGIN, 45.0)),
        links=_weigh(elbow_mm, flange_mm),
    )


_MAKE = ArmMake(KUKA, "robot", POSTURES, axes_of_status)
DESCRIPTIONS = {
    arm.variant: arm
    for arm in (
        _describe("kr6_r900_sixx", "#KR6R900_C4SR_FLR", 35.0, 80.0, (381.0, 388.0, 615.0)),
        _describe("kr6_r900_2", "#KR6R900_2_C4SR_FLR", 25.0, 90.0, (450.0, 450.0, 540.0)),
    )
}


def description(variant: str) -> RobotDescription:
    """Return the machine data of a variant. Raises BAD_SCENE for an arm that KUKA does not make."""
    if variant not in DESCRIPTIONS:
        raise BAD_SCENE(f"a KUKA controller moves {' or '.join(DESCRIPTIONS)}, not the scene's arm {variant}")
    return DESCRIPTIONS[variant]
