"""Occlusion by the head (an ellipsoid) and the arm (capsules) between markers and sensors.

Tracker frame, mm. A marker inside a body's hull is mounted on that body and protrudes from it, so that body
never hides it. The capsules are roughly the hull of the arm and its tools. Their joints are those of the
nominal arm, millimetres off the true one. Head and guide share one mount, which keeps clear of the patient:
a plate on the flange, a riser at its end, away from the patient, and a bridge from its top to the tool's
axis.

          top ---- bridge ---- on the axis
           |                        |
         riser                    tool
           |
    flange - plate - foot           :
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from sim.world.descriptions import DESCRIPTIONS
from sim.world.options import ArmRole
from sim.world.rigid import Matrix, Vector, Vectors, apply, inverse, matrix_of
from sim.world.scene.model import Head, Mount, Scene
from sim.world.world import ArmState

Flags = NDArray[np.bool_]
Limb = tuple[Vector, Vector, float]  # two ends (3,) and a radius

MOUNT_RADIUS_MM = 12.0
RISER_MM = 130.0  # distance from the tool's axis, towards the flange
RISER_TOP_MM = 170.0  # above the tool centre point
CAMERA_RADIUS_MM = 22.0  # housing of 29 mm, measured across its corners
GUIDE_RADIUS_MM = 8.0
CAMERA_LENGTH_MM = 80.0  # housing and lens, from the lens' centre backwards


def visible(
    eyes_mm: Vectors, points_mm: Vectors, bodies: tuple[OpaqueBody, ...], past_mount: Flags | None = None
) -> Flags:
    """Return flags (m, n) for whether each eye (m, 3) sees each point (n, 3) past all bodies.

    `past_mount` (n,) marks the points that the mount never hides.
    """
    seen = np.ones((len(eyes_mm), len(points_mm)), dtype=bool)
    if len(points_mm):
        for body in bodies:
            seen &= ~body.hides(eyes_mm, points_mm, past_mount)
    return seen


def head_ellipsoid(head: Head, tracker_from_robot: Matrix) -> OpaqueEllipsoid:
    """Return the scene's head as an ellipsoid in the tracker frame."""
    ct_from_tracker = inverse(tracker_from_robot @ matrix_of(head.robot_from_ct))
    unit_from_ct = np.diag([*(1.0 / np.array(head.semi_axes_mm)), 1.0])
    unit_from_ct[:3, 3] = -np.array(head.centre_ct_mm) / head.semi_axes_mm
    return OpaqueEllipsoid(unit_from_ct @ ct_from_tracker)


@dataclass(frozen=True)
class OpaqueEllipsoid:
    """Head ellipsoid, mapped to the unit sphere by `unit_from_tracker` (4, 4)."""

    unit_from_tracker: Matrix

    def hides(self, eyes_mm: Vectors, points_mm: Vectors, _past_mount: Flags | None = None) -> Flags:
        """Return flags (m, n) for whether the head hides each point (n, 3) from each eye (m, 3)."""
        eyes = apply(self.unit_from_tracker, eyes_mm)[:, None]
        points = apply(self.unit_from_tracker, points_mm)
        ways = points - eyes
        # nearest point of each segment to the centre
        share = np.clip(-(ways * eyes).sum(axis=-1) / (ways * ways).sum(axis=-1), 0.0, 1.0)
        nearest = eyes + share[..., None] * ways
        blocked = (nearest * nearest).sum(axis=-1) < 1.0
        mounted = (points * points).sum(axis=-1) < 1.0
        hidden: Flags = blocked & ~mounted
        return hidden


@dataclass(frozen=True)
class Capsules:
    """Arm links: c segments between points (c, 3), with radii `radii_mm` (c,).

    `of_mount` (c,) marks those of the mount.
    """

    starts_mm: Vectors
    ends_mm: Vectors
    radii_mm: Vectors
    of_mount: Flags | None = None

    def hides(self, eyes_mm: Vectors, points_mm: Vectors, past_mount: Flags | None = None) -> Flags:
        hidden = self._reach_rays(eyes_mm, points_mm)
        if past_mount is not None and self.of_mount is not None:
            hidden &= ~(past_mount[:, None] & self.of_mount)
        if hidden.any():
            hidden &= ~self._hold(points_mm)
        found: Flags = np.logical_or.reduce(hidden, axis=2)
        return found

    def _reach_rays(self, eyes_mm: Vectors, points_mm: Vectors) -> Flags:
        """Return flags (m, n, c) for whether each eye-point segment enters each capsule.

        (Ericson 2005, 5.1.9)
        """
        along = self.ends_mm - self.starts_mm
        ways = points_mm - eyes_mm[:, None]
        offsets = self.starts_mm - eyes_mm[:, None]
        # Scalar products, whose names are Ericson's, broadcast to (m, n, c).
        a = _squares(along)
        a = np.where(a > 0.0, a, 1.0)
        e = np.maximum(_squares(ways), np.finfo(float).tiny)[:, :, None]
        b = ways @ along.T
        c = (offsets * along).sum(axis=-1)[:, None]
        f = ways @ offsets.transpose(0, 2, 1)
        ae = a * e
        denominator = ae - b * b
        parallel = denominator < 1e-9 * ae
        s = _share(np.where(parallel, 0.0, (b * f - c * e) / np.where(parallel, 1.0, denominator)))
        t = _share((b * s + f) / e)
        s = _share((b * t - c) / a)
        squared = _squares(offsets)[:, None] + s * (s * a + 2.0 * c) + t * (t * e - 2.0 * (f + s * b))
        reached: Flags = squared < self.radii_mm * self.radii_mm
        return reached

    def _hold(self, points_mm: Vectors) -> Flags:
        """Return flags (n, c) for whether each point is inside each capsule."""
        along = self.ends_mm - self.starts_mm
        a = _squares(along)
        offsets = points_mm[:, None] - self.starts_mm
        shares = _share((offsets * along).sum(axis=-1) / np.where(a > 0.0, a, 1.0))
        return np.sqrt(_squares(offsets - shares[..., None] * along)) < self.radii_mm


OpaqueBody = OpaqueEllipsoid | Capsules


def _squares(vectors: Vectors) -> Vectors:
    """Return the squared lengths of vectors (..., 3)."""
    squares: Vectors = (vectors * vectors).sum(axis=-1)
    return squares


def _share(values: Vectors) -> Vectors:
    """Clamp values to 0..1, faster than `numpy.clip`."""
    return np.minimum(np.maximum(values, 0.0), 1.0)


class ArmBody:
    """Occluding body of an arm with any of its tools; the assistant's holder is too slim to count."""

    def __init__(self, scene: Scene, role: ArmRole = ArmRole.MASTER) -> None:
        mount, variant = scene.mount, scene.arm_of(role).variant
        self._corners = DESCRIPTIONS[variant].corners
        joints = DESCRIPTIONS[variant].joints[: self._corners[-1].joint + 1]
        radii_mm = [corner.radius_mm for corner in self._corners]
        self._origins_mm = [np.array(joint.origin_mm, dtype=float) for joint in joints]
        terms = [_rodrigues_terms(joint.axis) for joint in joints]
        self._once, self._twice = np.array([one for one, _ in terms]), np.array([two for _, two in terms])
        self._flange_from_tool = matrix_of(mount.flange_from_tool_true)
        mount_limbs, top = _mount(inverse(self._flange_from_tool)[:3, 3])
        self._bare = _LimbsOnTool(radii_mm, [], [])
        self._carried = {
            number: _LimbsOnTool(radii_mm, [*mount_limbs, *bars], carried)
            for number, (bars, carried) in (
                (mount.tool_number_guide, _guide(mount, top)),
                (mount.tool_number_stereo, _stereo_head(scene, top)),
            )
        }

    def capsules(self, arm: ArmState, mounted_tool: int, tracker_from_base: Matrix) -> Capsules:
        """Return the arm's capsules in the tracker frame."""
        flange = arm.robot_from_flange
        joints = apply(tracker_from_base, np.array([*self._corners_mm(arm), flange[:3, 3]]))
        limbs = self._carried.get(mounted_tool, self._bare)
        on_tool = apply(tracker_from_base @ flange @ self._flange_from_tool, limbs.ends_mm)
        return Capsules(
            np.concatenate([joints[:-1], on_tool[0::2]]),
            np.concatenate([joints[1:], on_tool[1::2]]),
            limbs.all_radii_mm,
            limbs.of_mount,
        )

    def _corners_mm(self, arm: ArmState) -> list[Vector]:
        """Return the positions of the corners in the base of the arm, mm."""
        angles = arm.joints_rad[: len(self._origins_mm)]
        sines = np.array([math.sin(angle) for angle in angles])[:, None, None]
        versines = np.array([1.0 - math.cos(angle) for angle in angles])[:, None, None]
        turns = np.eye(3) + sines * self._once + versines * self._twice
        rotation, place = np.eye(3), np.zeros(3)
        frames = []
        for origin, turn in zip(self._origins_mm, turns, strict=True):
            place = place + rotation @ origin
            rotation = rotation @ turn
            frames.append((place, rotation))
        return [
            frames[corner.joint][0] + frames[corner.joint][1] @ np.array(corner.offset_mm)
            for corner in self._corners
        ]


class _LimbsOnTool:
    """Limbs of the mount and its tool, each given by two end points in the tool frame.

    Radii and flags are those of the whole arm, whose own limbs come first.
    """

    def __init__(self, arm_radii_mm: list[float], mount: list[Limb], carried: list[Limb]) -> None:
        limbs = [*mount, *carried]
        self.ends_mm: Vectors = np.array([end for one in limbs for end in one[:2]], dtype=float).reshape(
            -1, 3
        )
        self.all_radii_mm: Vectors = np.array([*arm_radii_mm, *(radius for _, _, radius in limbs)])
        flags = [False] * len(arm_radii_mm) + [True] * len(mount) + [False] * len(carried)
        self.of_mount: Flags = np.array(flags)


def _mount(flange_mm: Vector) -> tuple[list[Limb], Vector]:
    """Return the mount's plate and riser, and the top of the riser, in the tool frame."""
    away_mm = float(np.linalg.norm(flange_mm[:2]))
    # A tool on the flange's axis may have its riser on any side.
    towards = flange_mm[:2] / away_mm if away_mm > 0.0 else np.array([-1.0, 0.0])
    beside = towards * RISER_MM
    foot, top = np.array([*beside, flange_mm[2]]), np.array([*beside, -RISER_TOP_MM])
    return [(flange_mm, foot, MOUNT_RADIUS_MM), (foot, top, MOUNT_RADIUS_MM)], top


def _guide(mount: Mount, top: Vector) -> tuple[list[Limb], list[Limb]]:
    """Return the bridge to the guide's upper end (part of the mount) and the tube, in the tool frame."""
    ends = [(0.0, 0.0, -mount.guide.reach_mm - up) for up in (0.0, mount.guide.bore_mm)]
    lower, upper = apply(matrix_of(mount.tool_from_tip_true), ends)
    return [(top, upper, MOUNT_RADIUS_MM)], [(upper, lower, GUIDE_RADIUS_MM)]


def _stereo_head(scene: Scene, top: Vector) -> tuple[list[Limb], list[Limb]]:
    """Return the bridge and camera beam (parts of the mount) and the cameras, in the tool frame."""
    ends = [(0.0, 0.0, 0.0), (0.0, 0.0, -CAMERA_LENGTH_MM)]  # the lens' centre, the back of the housing
    left, right = (apply(inverse(matrix_of(one.camera_from_tool)), ends) for one in (scene.left, scene.right))
    beam = (left.mean(axis=0), right.mean(axis=0))
    bars: list[Limb] = [(top, np.mean(beam, axis=0), MOUNT_RADIUS_MM), (*beam, MOUNT_RADIUS_MM)]
    return bars, [(*left, CAMERA_RADIUS_MM), (*right, CAMERA_RADIUS_MM)]


def _rodrigues_terms(axis: tuple[float, float, float]) -> tuple[Matrix, Matrix]:
    """Return the sine and 1 - cosine matrices of Rodrigues' formula for an axis."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return skew, skew @ skew
