"""Kinematics as the controller computes them: the chain of Denavit-Hartenberg parameters, in metres.

Poses on the wire are x y z and a rotation vector. The chain is written out in plain numbers, as it is needed
in every cycle; the inverse iterates from joints nearby.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import atan2, cos, hypot, sin, sqrt
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from sim.universal_robots.model import ALPHA_RAD, JOINTS, ZEROS, Model, Vector6

MM_PER_M = 1000.0
CONVERGED_M = 1e-10
CONVERGED_RAD = 1e-10
MOST_ITERATIONS = 60
LARGEST_STEP_RAD = 0.3  # of one iteration
DAMPING = 1e-9  # of the normal equations, which keeps steps near singular postures finite
NEARLY_HALF_A_TURN = -0.9  # cosine of a turn below which its sine is too small to have a direction


class LinkPose(NamedTuple):
    """Orientation row by row and position in metres."""

    r00: float
    r01: float
    r02: float
    r10: float
    r11: float
    r12: float
    r20: float
    r21: float
    r22: float
    x: float
    y: float
    z: float


IDENTITY = LinkPose(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)


def compose(a: LinkPose, b: LinkPose) -> LinkPose:
    """Return the frame `b` of frame `a` in the outer frame."""
    a00, a01, a02, a10, a11, a12, a20, a21, a22, ax, ay, az = a
    b00, b01, b02, b10, b11, b12, b20, b21, b22, bx, by, bz = b
    return LinkPose(
        a00 * b00 + a01 * b10 + a02 * b20,
        a00 * b01 + a01 * b11 + a02 * b21,
        a00 * b02 + a01 * b12 + a02 * b22,
        a10 * b00 + a11 * b10 + a12 * b20,
        a10 * b01 + a11 * b11 + a12 * b21,
        a10 * b02 + a11 * b12 + a12 * b22,
        a20 * b00 + a21 * b10 + a22 * b20,
        a20 * b01 + a21 * b11 + a22 * b21,
        a20 * b02 + a21 * b12 + a22 * b22,
        a00 * bx + a01 * by + a02 * bz + ax,
        a10 * bx + a11 * by + a12 * bz + ay,
        a20 * bx + a21 * by + a22 * bz + az,
    )


def inverted(a: LinkPose) -> LinkPose:
    """Return the outer frame in frame `a`."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22, x, y, z = a
    return LinkPose(
        r00, r10, r20, r01, r11, r21, r02, r12, r22,
        -(r00 * x + r10 * y + r20 * z),
        -(r01 * x + r11 * y + r21 * z),
        -(r02 * x + r12 * y + r22 * z),
    )  # fmt: skip


def frame_of_matrix_mm(pose: NDArray[np.float64]) -> LinkPose:
    """Return the frame of a pose (4, 4) in mm."""
    return LinkPose(*pose[:3, :3].ravel().tolist(), *(pose[:3, 3] / MM_PER_M).tolist())


def frame_of_pose(pose: Sequence[float]) -> LinkPose:
    """Return the frame of a pose x y z (m) rx ry rz (rad)."""
    x, y, z, rx, ry, rz = pose
    angle = sqrt(rx * rx + ry * ry + rz * rz)
    if angle == 0.0:
        return LinkPose(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, x, y, z)
    u, v, w = rx / angle, ry / angle, rz / angle
    c, s = cos(angle), sin(angle)
    k = 1.0 - c
    return LinkPose(
        c + u * u * k, u * v * k - w * s, u * w * k + v * s,
        v * u * k + w * s, c + v * v * k, v * w * k - u * s,
        w * u * k - v * s, w * v * k + u * s, c + w * w * k,
        x, y, z,
    )  # fmt: skip


def rotation_vector(frame: LinkPose) -> tuple[float, float, float]:
    """Return the rotation vector (rad) of a frame, of at most half a turn."""
    r00, r01, r02, r10, r11, r12, r20, r21, r22, *_ = frame
    x, y, z = r21 - r12, r02 - r20, r10 - r01  # 2 sin(angle) axis
    double_sine, cosine = sqrt(x * x + y * y + z * z), (r00 + r11 + r22 - 1.0) / 2.0
    angle = atan2(double_sine / 2.0, cosine)
    if cosine > NEARLY_HALF_A_TURN:
        scale = angle / double_sine if double_sine else 0.5
        return x * scale, y * scale, z * scale
    # The sine vanishes; the columns of what is symmetric, less the cosine, are along the axis.
    a, b, c = (r01 + r10) / 2.0, (r02 + r20) / 2.0, (r12 + r21) / 2.0
    columns = ((r00 - cosine, a, b), (a, r11 - cosine, c), (b, c, r22 - cosine))
    u, v, w = max(columns, key=lambda column: sum(value * value for value in column))
    scale = angle / sqrt(u * u + v * v + w * w)
    if u * x + v * y + w * z < 0.0:
        scale = -scale
    return u * scale, v * scale, w * scale


def pose_of_frame(frame: LinkPose) -> list[float]:
    """Return x y z (m) rx ry rz (rad) of a frame."""
    return [frame.x, frame.y, frame.z, *rotation_vector(frame)]


class TrueKinematics:
    """Chain of one arm, with the factory's differences to its model."""

    def __init__(
        self,
        model: Model,
        theta_rad: Vector6 = ZEROS,
        a_m: Vector6 = ZEROS,
        d_m: Vector6 = ZEROS,
        alpha_rad: Vector6 = ZEROS,
    ) -> None:
        self.theta_rad = theta_rad
        self.a_m = tuple(x + dx for x, dx in zip(model.a_m, a_m, strict=True))
        self.d_m = tuple(x + dx for x, dx in zip(model.d_m, d_m, strict=True))
        self.alpha_rad = tuple(x + dx for x, dx in zip(ALPHA_RAD, alpha_rad, strict=True))
        self._links = tuple(
            (theta, cos(alpha), sin(alpha), a, d)
            for theta, alpha, a, d in zip(theta_rad, self.alpha_rad, self.a_m, self.d_m, strict=True)
        )

    def flange(self, joints_rad: Sequence[float]) -> LinkPose:
        """Return the flange in the base."""
        r00 = r11 = r22 = 1.0
        r01 = r02 = r10 = r12 = r20 = r21 = x = y = z = 0.0
        for q, (theta, ca, sa, a, d) in zip(joints_rad, self._links, strict=True):
            c, s = cos(q + theta), sin(q + theta)
            u0, u1, u2 = r00 * c + r01 * s, r10 * c + r11 * s, r20 * c + r21 * s
            v0, v1, v2 = r01 * c - r00 * s, r11 * c - r10 * s, r21 * c - r20 * s
            x += d * r02 + a * u0
            y += d * r12 + a * u1
            z += d * r22 + a * u2
            r00, r10, r20 = u0, u1, u2
            r01, r11, r21 = v0 * ca + r02 * sa, v1 * ca + r12 * sa, v2 * ca + r22 * sa
            r02, r12, r22 = r02 * ca - v0 * sa, r12 * ca - v1 * sa, r22 * ca - v2 * sa
        return LinkPose(r00, r01, r02, r10, r11, r12, r20, r21, r22, x, y, z)

    def link_frames(self, joints_rad: Sequence[float]) -> list[LinkPose]:
        """Return the base and the frame behind each joint; a joint turns about z of the frame before it."""
        frame = IDENTITY
        frames = [frame]
        for q, (theta, ca, sa, a, d) in zip(joints_rad, self._links, strict=True):
            c, s = cos(q + theta), sin(q + theta)
            frame = compose(
                frame, LinkPose(c, -s * ca, s * sa, s, c * ca, -c * sa, 0.0, sa, ca, a * c, a * s, d)
            )
            frames.append(frame)
        return frames

    def jacobian(self, joints_rad: Sequence[float], tcp: LinkPose = IDENTITY) -> np.ndarray:
        """Return the Jacobian (6, 6) of the tool centre point in the base, translation first."""
        *links, flange = self.link_frames(joints_rad)
        end = compose(flange, tcp)
        columns = []
        for link in links:
            u, v, w, x, y, z = link.r02, link.r12, link.r22, link.x, link.y, link.z
            dx, dy, dz = end.x - x, end.y - y, end.z - z
            columns.append((v * dz - w * dy, w * dx - u * dz, u * dy - v * dx, u, v, w))
        return np.array(columns).T

    def joints_at(self, flange: LinkPose, near_rad: Sequence[float]) -> list[float] | None:
        """Return the joints nearest to `near_rad` that bring the flange there, or None if none are found."""
        joints = np.array(near_rad, dtype=float)
        for _ in range(MOST_ITERATIONS):
            here = self.flange(joints.tolist())
            turn = rotation_vector(compose(flange, inverted(here)))
            move = (flange.x - here.x, flange.y - here.y, flange.z - here.z)
            if hypot(*move) < CONVERGED_M and hypot(*turn) < CONVERGED_RAD:
                return [float(value) for value in joints]
            jacobian = self.jacobian(joints.tolist())
            normal = jacobian.T @ jacobian + DAMPING * np.eye(JOINTS)
            step = np.linalg.solve(normal, jacobian.T @ np.array([*move, *turn]))
            largest = float(np.abs(step).max())
            joints += step if largest <= LARGEST_STEP_RAD else step * (LARGEST_STEP_RAD / largest)
        return None
