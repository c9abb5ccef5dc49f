"""Geometric paths over a parameter s from 0 to 1, independent of time."""

from __future__ import annotations

from math import acos, sin
from typing import Protocol

from ronna_hw.arm.kinematics import Kinematics
from ronna_hw.arm.pose import Pose
from ronna_hw.devices.readings import JointVector, Quaternion, Vector3

NEARLY_PARALLEL = 0.9999995  # cosine of half a mrad: beyond it slerp divides by almost nothing


class Path(Protocol):
    """From the start of a motion to its target."""

    def joints(self, s: float, near: JointVector) -> JointVector:
        """Joint angles at `s`, 0..1, with the whole turns nearest to `near`."""
        ...


class JointPath:
    """A straight line in joint space: all axes start and end together."""

    def __init__(self, start_rad: JointVector, target_rad: JointVector) -> None:
        self.start_rad = start_rad
        self.target_rad = target_rad

    def joints(self, s: float, near: JointVector) -> JointVector:
        a, b = self.start_rad, self.target_rad
        r = 1.0 - s
        return (
            r * a[0] + s * b[0],
            r * a[1] + s * b[1],
            r * a[2] + s * b[2],
            r * a[3] + s * b[3],
            r * a[4] + s * b[4],
            r * a[5] + s * b[5],
        )


class LinePath:
    """A straight line of the tool centre point, orientation by slerp, in the branch of the start."""

    def __init__(
        self,
        kinematics: Kinematics,
        start_rad: JointVector,
        target: Pose,
        tool_in_flange_mm: Vector3 = (0.0, 0.0, 0.0),
    ) -> None:
        self.kinematics = kinematics
        self.branch = kinematics.branch_of(start_rad)
        begin = kinematics.forward(start_rad)
        self._tool = tool_in_flange_mm
        self._from_mm = begin.apply(tool_in_flange_mm)
        self._to_mm = target.apply(tool_in_flange_mm)
        self._from_q = begin.quaternion()
        to = target.quaternion()
        cosine = sum(a * b for a, b in zip(self._from_q, to, strict=True))
        if cosine < 0.0:  # the shorter way round
            to, cosine = (-to[0], -to[1], -to[2], -to[3]), -cosine
        self._to_q: Quaternion = to
        self._half_angle = acos(min(cosine, 1.0)) if cosine < NEARLY_PARALLEL else 0.0
        self.length_mm = sum((a - b) ** 2 for a, b in zip(self._from_mm, self._to_mm, strict=True)) ** 0.5
        self.angle_rad = begin.angle_rad(target)

    def flange(self, s: float) -> Pose:
        """Pose of the flange at `s`."""
        a, b = self._from_mm, self._to_mm
        r = 1.0 - s
        if self._half_angle:
            over = 1.0 / sin(self._half_angle)
            u, v = sin(r * self._half_angle) * over, sin(s * self._half_angle) * over
        else:
            u, v = r, s
        p, q = self._from_q, self._to_q
        turned = Pose.from_quaternion(
            (0.0, 0.0, 0.0),
            (u * p[0] + v * q[0], u * p[1] + v * q[1], u * p[2] + v * q[2], u * p[3] + v * q[3]),
        )
        x, y, z = turned.apply(self._tool)
        return Pose(
            (r * a[0] + s * b[0] - x, r * a[1] + s * b[1] - y, r * a[2] + s * b[2] - z), turned.rotation
        )

    def joints(self, s: float, near: JointVector) -> JointVector:
        return self.kinematics.solve_branch(self.flange(s), self.branch, near)
