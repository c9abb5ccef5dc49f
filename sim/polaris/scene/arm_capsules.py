"""The arm as a few capsules that block the tracker's line of sight.

Roughly the hull of a KR 6 R900 and of what its flange carries. The joints are those of the nominal arm,
which is millimetres away from the true one.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from sim.kuka.arm.robot_description import description
from sim.polaris.scene.line_of_sight import Capsule
from sim.theatre.rigid import Matrix, apply, inverse, matrix_from, matrix_of, rotation_from_vector
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


def arm_capsules(
    scene: Scene, arm: ArmState, mounted_tool: int, tracker_from_robot: Matrix
) -> tuple[Capsule, ...]:
    """The arm and what it carries as capsules, in the tracker frame."""

    def limb(start: ArrayLike, end: ArrayLike, radius_mm: float) -> Capsule:
        return Capsule(apply(tracker_from_robot, start), apply(tracker_from_robot, end), radius_mm)

    joints = _joints_mm(scene, arm)
    flange = arm.robot_from_flange
    tool = flange @ matrix_of(scene.mount.flange_from_tool_true)
    # The mount reaches sideways in the plane of the flange until it is above the tool centre point.
    side = tool[:3, 3] - flange[:3, 2] * scene.mount.flange_from_tool_true.translation_mm[2]
    body = [
        limb(joints[SHOULDER], joints[ELBOW], UPPER_ARM_RADIUS_MM),
        limb(joints[ELBOW], joints[WRIST], FOREARM_RADIUS_MM),
        limb(joints[WRIST], flange[:3, 3], WRIST_RADIUS_MM),
        limb(flange[:3, 3], side, MOUNT_RADIUS_MM),
    ]
    if mounted_tool == scene.mount.tool_number_guide:
        tip = tool @ matrix_of(scene.mount.tool_from_tip_true)
        body.append(limb(side, tip[:3, 3], GUIDE_RADIUS_MM))
    elif mounted_tool == scene.mount.tool_number_stereo:
        for camera in (scene.left, scene.right):
            seen_from = tool @ inverse(matrix_of(camera.camera_from_tool))
            lens, back = apply(seen_from, [(0.0, 0.0, 0.0), (0.0, 0.0, -CAMERA_LENGTH_MM)])
            body += [limb(side, lens, MOUNT_RADIUS_MM), limb(lens, back, CAMERA_RADIUS_MM)]
    return tuple(body)


def _joints_mm(scene: Scene, arm: ArmState) -> list[Vector]:
    """Positions of the six joints in the robot frame."""
    pose = np.eye(4)
    places = []
    for joint, angle in zip(description(scene.arm.variant).joints, arm.joints_rad, strict=True):
        pose = pose @ matrix_from(joint.origin_mm, rotation_from_vector(np.array(joint.axis) * angle))
        places.append(pose[:3, 3])
    return places
