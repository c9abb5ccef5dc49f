"""Inverse kinematics of a calibrated arm next to known joint angles, fast enough for a set-point each cycle.

Newton's method with the exact Jacobian of the individual chain. Its linear equations are solved by the
nominal arm's Jacobian J0, whose inverse is written out below: the wrist point, where the axes of wrist 2 and
wrist 3 meet, moves across the arm's plane by the base alone and in the plane by shoulder and elbow; the
turn of the flange gives the three wrists. As J0 differs from J by as little as the calibration does,
delta <- delta + J0^-1 (error - J delta) gains two digits or more a step, less near singular postures.

A step of Newton leaves an error of the order of its square: after a small enough one no forward kinematics
are needed to know that it was the last.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import cos, sin
from operator import le
from typing import NamedTuple

from ronna_hw.arm.kinematics import RANGE_SLACK_RAD, Branch
from ronna_hw.arm.pose import Pose, Rotation9
from ronna_hw.arm.universal_robots.geometry import Dimensions
from ronna_hw.arm.universal_robots.inverse import BEHIND, BENT_BACK, TURNED
from ronna_hw.vectors import JointVector, Vector3

NEAR_MM, NEAR_TURN = 20.0, 0.05  # from the known angles: beyond, the closed form is the better start
LAST_STEP_RAD = 1e-6  # half its square, at full reach, is below 1e-9 mm
SOLVED_RAD = 2e-13  # of the linear equations, at full reach 2e-10 mm
NEWTON_LIMIT, LINEAR_LIMIT = 6, 8
LEAST_SINE = 1e-3  # of elbow and wrist 2; nearer to singular postures J0 says too little
LEAST_AHEAD_MM = 1.0

Column = tuple[float, float, float, float, float, float]  # velocity of the flange, mm, and turn per rad


class Linearisation(NamedTuple):
    """Flange and Jacobian of the individual chain at some joint angles, and what J0 needs of them."""

    position_mm: Vector3
    rotation: Rotation9
    columns: list[Column]
    trigonometry: tuple[float, ...]


class LocalInverse:
    """Inverse kinematics of a chain Rz(q1) K1 .. Rz(q6) K6 that nearly is the arm of these dimensions."""

    def __init__(self, dimensions: Dimensions, transforms: Sequence[Pose]) -> None:
        self._arm = dimensions
        self._base, *self._links = ((*one.rotation, *one.position_mm) for one in transforms)
        self._low = tuple(end - RANGE_SLACK_RAD for end in dimensions.lower_rad)
        self._high = tuple(end + RANGE_SLACK_RAD for end in dimensions.upper_rad)
        self._start: tuple[JointVector, Linearisation] | None = None  # last: several set-points share it

    def solve(self, pose: Pose, branch: Branch, near: JointVector) -> JointVector | None:
        """Return the joint angles of `pose` in the neighbourhood of `near`.

        None if it is too far away, of another branch, out of the joint ranges or close to a singular posture.
        """
        if (start := self._start) is None or start[0] != near:
            start = self._start = (near, self._linearise(near))
        here = start[1]
        if not self._is_regular(here, branch):
            return None
        error = _error(pose, here)
        x, y, z, a, b, c = error
        if x * x + y * y + z * z > NEAR_MM * NEAR_MM or a * a + b * b + c * c > NEAR_TURN * NEAR_TURN:
            return None
        q = near
        first = self._step(here, error)
        if max(*first, -min(first)) > 2.0 * LAST_STEP_RAD:  # of this step not every digit is needed
            q = _sum(near, first)
            here = self._linearise(q)
            error = _error(pose, here)
        for _ in range(NEWTON_LIMIT):
            if (step := self._solve_linear(here, error)) is None:
                return None
            q = _sum(q, step)
            if max(*step, -min(step)) < LAST_STEP_RAD:
                return q if self._is_within(q) and self._is_regular(here, branch) else None
            here = self._linearise(q)
            error = _error(pose, here)
        return None

    def _is_within(self, q: JointVector) -> bool:
        return all(map(le, self._low, q)) and all(map(le, q, self._high))

    def _is_regular(self, here: Linearisation, branch: Branch) -> bool:
        """Whether J0 is a good guide, and the posture is of that branch."""
        _, _, _, _, _, _, _, _, s3, _, s5, ahead = here.trigonometry
        return (
            (ahead < -LEAST_AHEAD_MM if branch & BEHIND else ahead > LEAST_AHEAD_MM)
            and (s3 < -LEAST_SINE if branch & BENT_BACK else s3 > LEAST_SINE)
            and (s5 < -LEAST_SINE if branch & TURNED else s5 > LEAST_SINE)
        )

    def _linearise(self, joints_rad: JointVector) -> Linearisation:
        """Multiply out the chain, and take the axis of each joint on the way."""
        k0, k1, k2, k3, k4, k5, r6, r7, r8, kx, ky, z = self._base
        q1, q2, q3, q4, q5, q6 = joints_rad
        c1, s1 = c, s = cos(q1), sin(q1)
        r0, r1, r2 = c * k0 - s * k3, c * k1 - s * k4, c * k2 - s * k5
        r3, r4, r5 = s * k0 + c * k3, s * k1 + c * k4, s * k2 + c * k5
        x, y = c * kx - s * ky, s * kx + c * ky
        axes = [(0.0, 0.0, 1.0, 0.0, 0.0, 0.0)]
        for q, (k0, k1, k2, k3, k4, k5, k6, k7, k8, kx, ky, kz) in zip(
            (q2, q3, q4, q5, q6), self._links, strict=True
        ):
            axes.append((r2, r5, r8, x, y, z))
            c, s = cos(q), sin(q)
            a, b = r0 * c + r1 * s, r1 * c - r0 * s
            d, e = r3 * c + r4 * s, r4 * c - r3 * s
            f, g = r6 * c + r7 * s, r7 * c - r6 * s
            x += a * kx + b * ky + r2 * kz
            y += d * kx + e * ky + r5 * kz
            z += f * kx + g * ky + r8 * kz
            r0, r1, r2 = a * k0 + b * k3 + r2 * k6, a * k1 + b * k4 + r2 * k7, a * k2 + b * k5 + r2 * k8
            r3, r4, r5 = d * k0 + e * k3 + r5 * k6, d * k1 + e * k4 + r5 * k7, d * k2 + e * k5 + r5 * k8
            r6, r7, r8 = f * k0 + g * k3 + r8 * k6, f * k1 + g * k4 + r8 * k7, f * k2 + g * k5 + r8 * k8
        columns = []
        for u, v, w, ox, oy, oz in axes:
            ox, oy, oz = x - ox, y - oy, z - oz
            columns.append((v * oz - w * oy, w * ox - u * oz, u * oy - v * ox, u, v, w))
        q23 = q2 + q3
        arm, c2, c23, sp = self._arm, cos(q2), cos(q23), sin(q23 + q4)
        ahead = arm.a2_mm * c2 + arm.a3_mm * c23 + arm.d5_mm * sp
        angles = (c1, s1, c2, sin(q2), c23, sin(q23), cos(q23 + q4), sp, sin(q3), cos(q5), sin(q5))
        return Linearisation((x, y, z), (r0, r1, r2, r3, r4, r5, r6, r7, r8), columns, (*angles, ahead))

    def _solve_linear(self, here: Linearisation, error: Column) -> JointVector | None:
        """Return the step of Newton's method, or None if it does not converge."""
        x, y, z, a, b, c = error
        more = delta = self._step(here, error)
        largest = max(*more, -min(more))
        for _ in range(LINEAR_LIMIT):
            for by, (dx, dy, dz, da, db, dc) in zip(more, here.columns, strict=True):
                x -= by * dx
                y -= by * dy
                z -= by * dz
                a -= by * da
                b -= by * db
                c -= by * dc
            before = largest
            more = self._step(here, (x, y, z, a, b, c))
            delta = _sum(delta, more)
            largest = max(*more, -min(more))
            if largest * largest <= SOLVED_RAD * before:  # what another step would add
                return delta
        return None

    def _step(self, here: Linearisation, error: Column) -> JointVector:
        """Return J0^-1 error."""
        arm = self._arm
        c1, s1, c2, s2, c23, s23, cp, sp, s3, c5, s5, ahead = here.trigonometry
        vx, vy, vz, wx, wy, wz = error
        # Everything in the arm's plane: ahead (u), up, and along the parallel axes (n).
        v_u, v_n = c1 * vx + s1 * vy, s1 * vx - c1 * vy
        w_u, w_n = c1 * wx + s1 * wy, s1 * wx - c1 * wy
        d6 = arm.d6_mm
        z_u, z_up, z_n = -s5 * cp, -s5 * sp, c5
        # Of the wrist point, which is d6 behind the flange.
        v_u += d6 * (w_n * z_up - wz * z_n)
        v_up = vz + d6 * (w_u * z_n - w_n * z_u)
        v_n += d6 * (wz * z_u - w_u * z_up)
        base = -v_n / ahead
        wz -= base
        wrist_2 = w_u * sp - wz * cp
        wrist_3 = -(w_u * cp + wz * sp) / s5
        together = w_n - wrist_3 * c5  # turn of wrist 1 in the plane
        v_u -= arm.d4_mm * base + together * arm.d5_mm * cp
        v_up -= together * arm.d5_mm * sp
        shoulder = (v_u * c23 + v_up * s23) / (arm.a2_mm * s3)
        upper = -(v_u * c2 + v_up * s2) / (arm.a3_mm * s3)  # of shoulder and elbow
        return (base, shoulder, upper - shoulder, together - upper, wrist_2, wrist_3)


def _error(pose: Pose, here: Linearisation) -> Column:
    """Return the displacement and, for small angles, the turn from `here` to `pose`."""
    (x, y, z), (hx, hy, hz) = pose.position_mm, here.position_mm
    a, b, c, d, e, f, g, h, i = pose.rotation
    r0, r1, r2, r3, r4, r5, r6, r7, r8 = here.rotation
    return (
        x - hx,
        y - hy,
        z - hz,
        0.5 * (r3 * g - r6 * d + r4 * h - r7 * e + r5 * i - r8 * f),
        0.5 * (r6 * a - r0 * g + r7 * b - r1 * h + r8 * c - r2 * i),
        0.5 * (r0 * d - r3 * a + r1 * e - r4 * b + r2 * f - r5 * c),
    )


def _sum(a: JointVector, b: JointVector) -> JointVector:
    return (a[0] + b[0], a[1] + b[1], a[2] + b[2], a[3] + b[3], a[4] + b[4], a[5] + b[5])
