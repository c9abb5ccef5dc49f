"""Poses and joint vectors as plain floats.

The real-time loop of the robot creates a pose per cycle, so it consists of tuples and imports neither NumPy
nor SciPy. `to_transform` and `from_transform` convert to the checked transforms used elsewhere.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from math import degrees, radians
from typing import TYPE_CHECKING, NamedTuple, Self

from ronna_hw.vectors import JointVector, Quaternion, Vector3

if TYPE_CHECKING:
    from ronna_hw.frames import Transform

Rotation9 = tuple[float, float, float, float, float, float, float, float, float]

_IDENTITY: Rotation9 = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
_GIMBAL_COSINE = 1e-9  # below this cos(B), only A minus or plus C is defined and C is set to 0


class Pose(NamedTuple):
    """Rigid motion: position in mm and row-major rotation matrix.

    By default, the flange in the robot base.
    """

    position_mm: Vector3 = (0.0, 0.0, 0.0)
    rotation: Rotation9 = _IDENTITY

    @classmethod
    def from_kuka(cls, X: float, Y: float, Z: float, A: float, B: float, C: float) -> Self:
        """Build from mm and degrees in KUKA's convention: R = Rz(A) Ry(B) Rx(C)."""
        ca, sa = math.cos(math.radians(A)), math.sin(math.radians(A))
        cb, sb = math.cos(math.radians(B)), math.sin(math.radians(B))
        cc, sc = math.cos(math.radians(C)), math.sin(math.radians(C))
        rotation = (
            ca * cb,
            ca * sb * sc - sa * cc,
            ca * sb * cc + sa * sc,
            sa * cb,
            sa * sb * sc + ca * cc,
            sa * sb * cc - ca * sc,
            -sb,
            cb * sc,
            cb * cc,
        )
        return cls((X, Y, Z), rotation)

    def to_kuka(self) -> tuple[float, float, float, float, float, float]:
        """Return X, Y, Z in mm and A, B, C in deg, B within ±90. At B = ±90, C is 0 by convention."""
        r = self.rotation
        cos_b = math.hypot(r[0], r[3])
        B = math.atan2(-r[6], cos_b)
        if cos_b > _GIMBAL_COSINE:
            A, C = math.atan2(r[3], r[0]), math.atan2(r[7], r[8])
        else:
            A, C = math.atan2(-r[1], r[4]), 0.0
        return (*self.position_mm, math.degrees(A), math.degrees(B), math.degrees(C))

    @classmethod
    def from_quaternion(cls, position_mm: Vector3, quaternion: Quaternion) -> Self:
        """Build from a position in mm and a scalar-first quaternion of any non-zero length."""
        w, x, y, z = quaternion
        n = 2.0 / (w * w + x * x + y * y + z * z)
        rotation = (
            1 - n * (y * y + z * z),
            n * (x * y - w * z),
            n * (x * z + w * y),
            n * (x * y + w * z),
            1 - n * (x * x + z * z),
            n * (y * z - w * x),
            n * (x * z - w * y),
            n * (y * z + w * x),
            1 - n * (x * x + y * y),
        )
        return cls(position_mm, rotation)

    def quaternion(self) -> Quaternion:
        """Scalar-first unit quaternion with non-negative scalar part."""
        r = self.rotation
        # The largest of the four components is computed first: its square root is never near zero.
        trace = r[0] + r[4] + r[8]
        largest = max(trace, r[0], r[4], r[8])
        if largest == trace:
            raw = (1 + trace, r[7] - r[5], r[2] - r[6], r[3] - r[1])
        elif largest == r[0]:
            raw = (r[7] - r[5], 1 + r[0] - r[4] - r[8], r[1] + r[3], r[2] + r[6])
        elif largest == r[4]:
            raw = (r[2] - r[6], r[1] + r[3], 1 - r[0] + r[4] - r[8], r[5] + r[7])
        else:
            raw = (r[3] - r[1], r[2] + r[6], r[5] + r[7], 1 - r[0] - r[4] + r[8])
        n = math.sqrt(sum(c * c for c in raw))
        if raw[0] < 0:
            n = -n
        return (raw[0] / n, raw[1] / n, raw[2] / n, raw[3] / n)

    def compose(self, other: Pose) -> Pose:
        """Compose with `other`, which is applied first: (a <- b).compose(b <- c) is a <- c."""
        a, b = self.rotation, other.rotation
        rotation = (
            a[0] * b[0] + a[1] * b[3] + a[2] * b[6],
            a[0] * b[1] + a[1] * b[4] + a[2] * b[7],
            a[0] * b[2] + a[1] * b[5] + a[2] * b[8],
            a[3] * b[0] + a[4] * b[3] + a[5] * b[6],
            a[3] * b[1] + a[4] * b[4] + a[5] * b[7],
            a[3] * b[2] + a[4] * b[5] + a[5] * b[8],
            a[6] * b[0] + a[7] * b[3] + a[8] * b[6],
            a[6] * b[1] + a[7] * b[4] + a[8] * b[7],
            a[6] * b[2] + a[7] * b[5] + a[8] * b[8],
        )
        return Pose(self.apply(other.position_mm), rotation)

    def inverse(self) -> Pose:
        """Return the inverse motion."""
        r = self.rotation
        back = Pose((0.0, 0.0, 0.0), (r[0], r[3], r[6], r[1], r[4], r[7], r[2], r[5], r[8]))
        x, y, z = back.apply(self.position_mm)
        return Pose((-x, -y, -z), back.rotation)

    def apply(self, point_mm: Vector3) -> Vector3:
        """Map a point (3) in mm."""
        x, y, z = point_mm
        r, p = self.rotation, self.position_mm
        return (
            r[0] * x + r[1] * y + r[2] * z + p[0],
            r[3] * x + r[4] * y + r[5] * z + p[1],
            r[6] * x + r[7] * y + r[8] * z + p[2],
        )

    def rotate(self, vector: Vector3) -> Vector3:
        """Return a vector given in the pose's own frame, such as a force, in the frame of the pose."""
        r, (x, y, z) = self.rotation, vector
        return (
            r[0] * x + r[1] * y + r[2] * z,
            r[3] * x + r[4] * y + r[5] * z,
            r[6] * x + r[7] * y + r[8] * z,
        )

    def distance_mm(self, other: Pose) -> float:
        """Return the distance between the two origins, mm."""
        return math.dist(self.position_mm, other.position_mm)

    def angle_rad(self, other: Pose) -> float:
        """Return the rotation angle between the two orientations, 0..pi; accurate near zero."""
        w, x, y, z = self.inverse().compose(other).quaternion()
        return 2.0 * math.atan2(math.sqrt(x * x + y * y + z * z), w)

    @classmethod
    def from_matrix(cls, matrix: Sequence[Sequence[float]]) -> Self:
        """Build from a 4x4 homogeneous matrix in mm, assumed to be rigid."""
        a, b, c = (tuple(float(v) for v in row) for row in list(matrix)[:3])
        return cls((a[3], b[3], c[3]), (a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]))

    @classmethod
    def from_transform(cls, transform: Transform) -> Self:
        """Convert a checked transform; raises FRM-001 if it is not ROBOT <- FLANGE."""
        from ronna_hw.frames import FRAME_MISMATCH, Frame

        if (transform.target, transform.source) != (Frame.ROBOT, Frame.FLANGE):
            raise FRAME_MISMATCH(
                "a flange pose needs robot <- flange", got=f"{transform.target} <- {transform.source}"
            )
        return cls.from_matrix(transform.as_matrix().tolist())

    def to_transform(self) -> Transform:
        """Convert to the checked transform ROBOT <- FLANGE.

        Not for the real-time loop, as it imports SciPy.
        """
        from ronna_hw.frames import Frame, Transform

        return Transform.of(
            Frame.ROBOT, Frame.FLANGE, translation_mm=self.position_mm, quaternion_wxyz=self.quaternion()
        )


def radians6(a: float, b: float, c: float, d: float, e: float, f: float) -> JointVector:
    """Convert six angles from degrees to radians."""
    return (radians(a), radians(b), radians(c), radians(d), radians(e), radians(f))


def degrees6(joints_rad: JointVector) -> JointVector:
    """Convert six angles from radians to degrees."""
    a, b, c, d, e, f = joints_rad
    return (degrees(a), degrees(b), degrees(c), degrees(d), degrees(e), degrees(f))
