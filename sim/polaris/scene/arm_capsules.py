"""The arm as a few capsules that block the tracker's line of sight.

Roughly the hull of a KR 6 R900 and of what its flange carries. The joints are those of the nominal arm,
which is millimetres away from the true one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from sim.kuka.arm.robot_description import description
from sim.polaris.scene.line_of_sight import Capsules
from sim.theatre.rigid import Matrix, apply, inverse, matrix_of
from sim.theatre.scene.model import Scene
from sim.theatre.world import ArmState

Vector = NDArray[np.float64]

UPPER_ARM_RADIUS_MM = 90.0
FOREARM_RADIUS_MM = 55.0
WRIST_RADIUS_MM = 45.0
MOUNT_RADIUS_MM = 15.0
CAMERA_RADIUS_MM = 22.0  # housing of 29 mm, measured over its corners
GUIDE_RADIUS_MM = 8.0
CAMERA_LENGTH_MM = 80.0  # of housing and lens, from the lens' centre backwards
SHOULDER, ELBOW, WRIST = 1, 2, 4  # joints between which upper arm and forearm reach


class ArmBody:
    """The arm of a scene and what may hang on it."""

    def __init__(self, scene: Scene) -> None:
        mount = scene.mount
        self._mount = mount
        self._joints = [
            (np.array(joint.origin_mm, dtype=float), _turns(joint.axis))
            for joint in description(scene.arm.variant).joints[: WRIST + 1]
        ]
        self._flange_from_tool = matrix_of(mount.flange_from_tool_true)
        ends_of_guide_mm = [(0.0, 0.0, -mount.guide.reach_mm - up) for up in (0.0, mount.guide.bore_mm)]
        # Per camera, tool frame: the lens' centre and the back of the housing.
        ends_mm = [(0.0, 0.0, 0.0), (0.0, 0.0, -CAMERA_LENGTH_MM)]
        cameras_mm = [
            apply(inverse(matrix_of(camera.camera_from_tool)), ends_mm)
            for camera in (scene.left, scene.right)
        ]
        self._carried_mm = {
            mount.tool_number_guide: apply(matrix_of(mount.tool_from_tip_true), ends_of_guide_mm),
            mount.tool_number_stereo: np.vstack(cameras_mm),
        }

    def capsules(self, arm: ArmState, mounted_tool: int, tracker_from_robot: Matrix) -> Capsules:
        """In the tracker frame."""
        shoulder, elbow, wrist = self._joints_mm(arm)
        flange = arm.robot_from_flange
        tool = flange @ self._flange_from_tool
        hand = flange[:3, 3]
        # The mount reaches sideways in the plane of the flange until it is above the tool centre point.
        side = tool[:3, 3] - flange[:3, 2] * self._flange_from_tool[2, 3]
        limbs = [
            (shoulder, elbow, UPPER_ARM_RADIUS_MM),
            (elbow, wrist, FOREARM_RADIUS_MM),
            (wrist, hand, WRIST_RADIUS_MM),
            (hand, side, MOUNT_RADIUS_MM),
        ]
        if mounted_tool in self._carried_mm:
            carried = apply(tool, self._carried_mm[mounted_tool])
            if mounted_tool == self._mount.tool_number_guide:
                lower, upper = carried
                limbs += [(side, upper, MOUNT_RADIUS_MM), (upper, lower, GUIDE_RADIUS_MM)]
            else:
                for lens, back in zip(carried[::2], carried[1::2], strict=True):
                    limbs += [(side, lens, MOUNT_RADIUS_MM), (lens, back, CAMERA_RADIUS_MM)]
        starts, ends, radii = (np.array(column) for column in zip(*limbs, strict=True))
        return Capsules(apply(tracker_from_robot, starts), apply(tracker_from_robot, ends), radii)

    def _joints_mm(self, arm: ArmState) -> tuple[Vector, Vector, Vector]:
        """Shoulder, elbow and wrist in the robot frame."""
        rotation, place = np.eye(3), np.zeros(3)
        places = []
        for (origin, (once, twice)), angle in zip(self._joints, arm.joints_rad, strict=False):
            place = place + rotation @ origin
            rotation = rotation @ (np.eye(3) + math.sin(angle) * once + (1.0 - math.cos(angle)) * twice)
            places.append(place)
        return places[SHOULDER], places[ELBOW], places[WRIST]


def _turns(axis: tuple[float, float, float]) -> tuple[Matrix, Matrix]:
    """What a rotation about an axis adds to the identity, times sine and one minus cosine (Rodrigues)."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return skew, skew @ skew
