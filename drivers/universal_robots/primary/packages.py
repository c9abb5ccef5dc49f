"""Packages of the primary interface; of the longer parts of newer controllers the rest is skipped."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass
from hashlib import sha256
from typing import NamedTuple

from drivers.universal_robots.errors import BAD_BYTES
from ronna_hw.vectors import JointVector, joint_vector
from ronna_hw.wire import universal_robots_services as wire
from ronna_hw.wire.universal_robots_services import PartKind

HEADER = struct.Struct(wire.PACKAGE_HEADER)
LONGEST_PACKAGE_BYTES = 1 << 16
PART_HEADER = struct.Struct(wire.PART_HEADER)
JOINTS = 6
MM_PER_M = 1000.0

MODE = struct.Struct(wire.MODE_PART)
JOINT = struct.Struct(wire.JOINT_PART)
MASTERBOARD = struct.Struct(wire.MASTERBOARD_PART)
KINEMATICS = struct.Struct(wire.KINEMATICS_PART)
MESSAGE = struct.Struct(wire.MESSAGE_HEADER)
MOVING_RAD_S = 1e-3
FARTHEST_JOINT_RAD = 8.0  # from zero: a joint turns by 363 deg either way


class RobotModeData(NamedTuple):
    """Power, stops and program, from the part MODE."""

    timestamp_us: int
    is_connected: bool
    is_enabled: bool
    is_powered: bool
    is_emergency_stopped: bool
    is_protectively_stopped: bool
    is_program_running: bool
    is_program_paused: bool
    robot_mode: int
    control_mode: int
    speed_fraction: float
    speed_scaling: float


class Joints(NamedTuple):
    """Measured joints, from the part JOINTS."""

    angles_rad: JointVector
    moving: bool


class Masterboard(NamedTuple):
    """Inputs and safety mode, from the part MASTERBOARD."""

    digital_inputs: int
    safety_mode: int


@dataclass(frozen=True)
class KinematicsInfo:
    """Factory calibration of the arm, from the part KINEMATICS; sums of nominal values and differences."""

    checksums: tuple[int, ...]
    theta_rad: JointVector
    a_mm: JointVector
    d_mm: JointVector
    alpha_rad: JointVector
    status: int

    @property
    def fingerprint(self) -> str:
        """Short text that differs between any two calibrations."""
        numbers = (*self.theta_rad, *self.a_mm, *self.d_mm, *self.alpha_rad)
        return sha256(struct.pack(">6I24d", *self.checksums, *numbers)).hexdigest()[:16]


@dataclass(frozen=True)
class Message:
    """Message of the controller, with the text in it."""

    kind: int
    text: str


Part = RobotModeData | Joints | Masterboard | KinematicsInfo


def iterate_parts(payload: bytes) -> Iterator[Part]:
    """Yield the parts of a robot state that are known here; raises URD-016."""
    offset = 0
    while offset < len(payload):
        if len(payload) - offset < PART_HEADER.size:
            raise BAD_BYTES("a part of the robot state is cut off", wire=payload)
        size, kind = PART_HEADER.unpack_from(payload, offset)
        if not PART_HEADER.size <= size <= len(payload) - offset:
            raise BAD_BYTES(f"a part of the robot state has {size} bytes", wire=payload[offset:])
        if (part := _read_part(kind, payload[offset + PART_HEADER.size : offset + size])) is not None:
            yield part
        offset += size


def _read_part(kind: int, body: bytes) -> Part | None:
    try:
        if kind == PartKind.MODE:
            return RobotModeData(*MODE.unpack_from(body))
        if kind == PartKind.JOINTS:
            rows = [JOINT.unpack_from(body, k * JOINT.size) for k in range(JOINTS)]
            if not all(abs(row[0]) <= FARTHEST_JOINT_RAD for row in rows):  # also if one is no number
                raise BAD_BYTES("joint angles that no arm has", wire=body)
            return Joints(
                joint_vector(row[0] for row in rows), any(abs(row[2]) > MOVING_RAD_S for row in rows)
            )
        if kind == PartKind.MASTERBOARD:
            values = MASTERBOARD.unpack_from(body)
            return Masterboard(values[0], values[-1])
        if kind == PartKind.KINEMATICS:
            return _read_kinematics(KINEMATICS.unpack_from(body))
    except struct.error as error:
        raise BAD_BYTES(f"part {kind} of the robot state is too short", wire=body) from error
    return None


def _read_kinematics(values: tuple[float, ...]) -> KinematicsInfo:
    checksums = tuple(int(value) for value in values[:JOINTS])
    theta, a, d, alpha = (joint_vector(values[start : start + JOINTS]) for start in range(6, 30, 6))
    return KinematicsInfo(
        checksums,
        theta,
        joint_vector(MM_PER_M * value for value in a),
        joint_vector(MM_PER_M * value for value in d),
        alpha,
        int(values[30]),
    )


def read_message(payload: bytes) -> Message:
    """Decode a message; raises URD-016. Its text is whatever of it is readable."""
    if len(payload) < MESSAGE.size:
        raise BAD_BYTES("a message is cut off", wire=payload)
    _, _, kind = MESSAGE.unpack_from(payload)
    return Message(kind, _readable(payload[MESSAGE.size :]))


def _readable(body: bytes) -> str:
    """Return the longest run of printable characters."""
    text = body.decode("latin-1")
    runs = "".join(letter if letter.isprintable() and letter.isascii() else "\n" for letter in text)
    return max(runs.split("\n"), key=len).strip()
