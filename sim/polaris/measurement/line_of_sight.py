"""Occlusion by the head (an ellipsoid) and the arm (capsules) between marker and sensor.

Tracker frame, mm. A marker inside a body's hull is mounted on that body and protrudes from it, so that body
never hides it. The capsules are roughly the hull of a KR 6 R900 and its tools. Their joints are those of the
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
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from sim.world.nominal_arm import description
from sim.world.rigid import Matrix, apply, inverse, matrix_of
from sim.world.scene.model import Head, Mount, Scene
from sim.world.world import ArmState

Vectors = NDArray[np.float64]
Flags = NDArray[np.bool_]
Vector = NDArray[np.float64]
Limb = tuple[Vector, Vector, float]  # two ends (3,) and a radius

UPPER_ARM_RADIUS_MM = 90.0
FOREARM_RADIUS_MM = 55.0
WRIST_RADIUS_MM = 45.0
MOUNT_RADIUS_MM = 12.0
RISER_MM = 130.0  # distance from the tool's axis, towards the flange
RISER_TOP_MM = 170.0  # above the tool centre point
CAMERA_RADIUS_MM = 22.0  # housing of 29 mm, measured across its corners
GUIDE_RADIUS_MM = 8.0
CAMERA_LENGTH_MM = 80.0  # housing and lens, from the lens' centre backwards
SHOULDER, ELBOW, WRIST = 1, 2, 4  # joints at the ends of upper arm and forearm


def visible(eyes_mm: Vectors, points_mm: Vectors, bodies: tuple[Body, ...]) -> Flags:
    """Flags (m, n): whether each of the eyes (m, 3) sees each of the points (n, 3) past all bodies."""
    seen = np.ones((len(eyes_mm), len(points_mm)), dtype=bool)
    if len(points_mm):
        for body in bodies:
            seen &= ~body.hides(eyes_mm, points_mm)
    return seen


class Body(Protocol):
    """An opaque body."""

    def hides(self, eyes_mm: Vectors, points_mm: Vectors) -> Flags:
        """Flags (m, n): whether the body hides each of the points (n, 3) from each of the eyes (m, 3)."""
        ...


def head_ellipsoid(head: Head, tracker_from_robot: Matrix) -> Ellipsoid:
    """Head of a scene in the tracker frame."""
    ct_from_tracker = inverse(tracker_from_robot @ matrix_of(head.robot_from_ct))
    unit_from_ct = np.diag([*(1.0 / np.array(head.semi_axes_mm)), 1.0])
    unit_from_ct[:3, 3] = -np.array(head.centre_ct_mm) / head.semi_axes_mm
    return Ellipsoid(unit_from_ct @ ct_from_tracker)


@dataclass(frozen=True)
class Ellipsoid:
    """A head; `unit_from_tracker` (4, 4) maps it to the unit sphere."""

    unit_from_tracker: Matrix

    def hides(self, eyes_mm: Vectors, points_mm: Vectors) -> Flags:
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
    """Links of an arm: all within `radii_mm` (c,) of c segments between points (c, 3)."""

    starts_mm: Vectors
    ends_mm: Vectors
    radii_mm: Vectors

    def hides(self, eyes_mm: Vectors, points_mm: Vectors) -> Flags:
        starts, ends, radii = self.starts_mm[:, None], self.ends_mm[:, None], self.radii_mm[:, None]
        blocked = _segment_distances(starts, ends, eyes_mm[:, None, None], points_mm) < radii
        mounted = _segment_distances(starts, ends, points_mm, points_mm) < radii
        hidden: Flags = np.logical_or.reduce(blocked & ~mounted, axis=1)
        return hidden


def _segment_distances(starts: Vectors, ends: Vectors, eyes: Vectors, points: Vectors) -> Vectors:
    """Distance between each segment start-end and each segment eye-point (Ericson 2005, 5.1.9).

    All four (..., 3), broadcast against each other.
    """
    along, ways, offsets = ends - starts, points - eyes, starts - eyes
    a = (along * along).sum(axis=-1)
    a = np.where(a > 0.0, a, 1.0)
    e = np.maximum((ways * ways).sum(axis=-1), np.finfo(float).tiny)
    b = (ways * along).sum(axis=-1)
    c = (offsets * along).sum(axis=-1)
    f = (ways * offsets).sum(axis=-1)
    denominator = a * e - b * b
    parallel = denominator < 1e-9 * a * e
    s = np.clip(np.where(parallel, 0.0, (b * f - c * e) / np.where(parallel, 1.0, denominator)), 0.0, 1.0)
    t = np.clip((b * s + f) / e, 0.0, 1.0)
    s = np.clip((b * t - c) / a, 0.0, 1.0)
    between = starts + s[..., None] * along - (eyes + t[..., None] * ways)
    distances: Vectors = np.sqrt((between * between).sum(axis=-1))
    return distances


class ArmBody:
    """The arm of a scene with either tool."""

    def __init__(self, scene: Scene) -> None:
        mount = scene.mount
        self._joints = [
            (np.array(joint.origin_mm, dtype=float), _rodrigues_terms(joint.axis))
            for joint in description(scene.arm.variant).joints[: WRIST + 1]
        ]
        self._flange_from_tool = matrix_of(mount.flange_from_tool_true)
        self._mount_limbs, top = _mount(inverse(self._flange_from_tool)[:3, 3])
        self._carried = {
            mount.tool_number_guide: _guide(mount, top),
            mount.tool_number_stereo: _stereo_head(scene, top),
        }

    def capsules(
        self, arm: ArmState, mounted_tool: int, tracker_from_robot: Matrix, *, past_mount: bool = False
    ) -> Capsules:
        """Capsules in the tracker frame; `past_mount` omits the mount, for objects on the mount itself."""
        shoulder, elbow, wrist = self._joints_mm(arm)
        flange = arm.robot_from_flange
        limbs: list[Limb] = [
            (shoulder, elbow, UPPER_ARM_RADIUS_MM),
            (elbow, wrist, FOREARM_RADIUS_MM),
            (wrist, flange[:3, 3], WRIST_RADIUS_MM),
        ]
        bars, carried = self._carried.get(mounted_tool, ([], []))
        on_tool = carried if past_mount else [*self._mount_limbs, *bars, *carried]
        tool = flange @ self._flange_from_tool
        if on_tool:
            begins, stops, radii = zip(*on_tool, strict=True)
            limbs += zip(apply(tool, np.array(begins)), apply(tool, np.array(stops)), radii, strict=True)
        starts, ends, thick = (np.array(column) for column in zip(*limbs, strict=True))
        return Capsules(apply(tracker_from_robot, starts), apply(tracker_from_robot, ends), thick)

    def _joints_mm(self, arm: ArmState) -> tuple[Vector, Vector, Vector]:
        """Shoulder, elbow and wrist in the robot frame."""
        rotation, place = np.eye(3), np.zeros(3)
        places = []
        for (origin, (once, twice)), angle in zip(self._joints, arm.joints_rad, strict=False):
            place = place + rotation @ origin
            rotation = rotation @ (np.eye(3) + math.sin(angle) * once + (1.0 - math.cos(angle)) * twice)
            places.append(place)
        return places[SHOULDER], places[ELBOW], places[WRIST]


def _mount(flange_mm: Vector) -> tuple[list[Limb], Vector]:
    """Plate and riser, and the end of the riser; tool frame."""
    away_mm = float(np.linalg.norm(flange_mm[:2]))
    # A tool on the flange's axis may have its riser on any side.
    towards = flange_mm[:2] / away_mm if away_mm > 0.0 else np.array([-1.0, 0.0])
    beside = towards * RISER_MM
    foot, top = np.array([*beside, flange_mm[2]]), np.array([*beside, -RISER_TOP_MM])
    return [(flange_mm, foot, MOUNT_RADIUS_MM), (foot, top, MOUNT_RADIUS_MM)], top


def _guide(mount: Mount, top: Vector) -> tuple[list[Limb], list[Limb]]:
    """Bridge to the upper end (part of the mount), and the tube; tool frame."""
    ends = [(0.0, 0.0, -mount.guide.reach_mm - up) for up in (0.0, mount.guide.bore_mm)]
    lower, upper = apply(matrix_of(mount.tool_from_tip_true), ends)
    return [(top, upper, MOUNT_RADIUS_MM)], [(upper, lower, GUIDE_RADIUS_MM)]


def _stereo_head(scene: Scene, top: Vector) -> tuple[list[Limb], list[Limb]]:
    """Bridge and camera beam (parts of the mount), and the cameras; tool frame."""
    ends = [(0.0, 0.0, 0.0), (0.0, 0.0, -CAMERA_LENGTH_MM)]  # the lens' centre, the back of the housing
    left, right = (apply(inverse(matrix_of(one.camera_from_tool)), ends) for one in (scene.left, scene.right))
    beam = (left.mean(axis=0), right.mean(axis=0))
    bars: list[Limb] = [(top, np.mean(beam, axis=0), MOUNT_RADIUS_MM), (*beam, MOUNT_RADIUS_MM)]
    return bars, [(*left, CAMERA_RADIUS_MM), (*right, CAMERA_RADIUS_MM)]


def _rodrigues_terms(axis: tuple[float, float, float]) -> tuple[Matrix, Matrix]:
    """Matrices that Rodrigues' formula multiplies by sine and by 1 - cosine, for an axis."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return skew, skew @ skew
