"""Arm with known deviations: where its flange is, and which pose to command for a wanted one.

A controller knows only the nominal chain. It is given an offset pose, from which the deviations lead to the
wanted one. They are small and smooth, so each iteration leaves a thousandth of the error.

Guards ask many times a second where one arm is, one posture at a time. `PostureModel` therefore evaluates the
formula of `deviations` in plain floats, ten times faster than arrays of one row.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple, cast

from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.errors import Unreachable
from ronna_hw.arm.kinematics import Chain, Kinematics
from ronna_hw.arm.pose import Pose, Rotation9
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.deviations import (
    FLANK_SHARE,
    HARMONICS,
    WRIST_JOINTS,
    ArmDeviations,
    flange_poses,
    stretched_mm,
)
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector, Vector3, vector3

CLOSE_MM = 1e-5  # resolution of a record's numbers
CLOSE_RAD = 1e-8
MOST_ROUNDS = 8  # four suffice for an uncalibrated arm away from singularities


class PostureModel:
    """Deviations of one arm, evaluated for one posture at a time: `flange_poses` in plain floats."""

    def __init__(self, chain: Chain, deviations: ArmDeviations) -> None:
        plain = deviations.as_plain()
        self._chain = chain
        self._nominal_links = [Pose(joint.to_next_mm) for joint in chain.joints]
        self._links = [
            Pose(_sum(joint.to_next_mm, shift_mm), _turn(turn_rad).rotation)
            for joint, shift_mm, turn_rad in zip(
                chain.joints, plain["link_translation_mm"], plain["link_rotation_rad"], strict=True
            )
        ]
        self._flange = Pose(rotation=chain.flange_rotation)
        self._offset_rad: Sequence[float] = plain["joint_offset_rad"]
        self._harmonics = list(zip(plain["sine_rad"], plain["cosine_rad"], strict=True))
        self._half_backlash_rad = [FLANK_SHARE * one for one in plain["backlash_rad"]]
        self._sag_rad_per_mm = [
            sag_rad / length_mm if length_mm > 0.0 else 0.0
            for sag_rad, length_mm in zip(plain["sag_rad"], stretched_mm(chain), strict=True)
        ]

    def forward(self, joints_rad: JointVector, flanks: Sequence[float] | None) -> Pose:
        """Return the pose ROBOT <- FLANGE at encoder angles, with the backlash sides `flanks`, if known."""
        pose = Pose(self._chain.base_mm)
        errors_rad = self._joint_errors(joints_rad, flanks)
        for joint, link, angle_rad, error_rad in zip(
            self._chain.joints, self._links, joints_rad, errors_rad, strict=True
        ):
            pose = pose.compose(_turn(_scaled(joint.axis, angle_rad + error_rad))).compose(link)
        return pose.compose(self._flange)

    def _joint_errors(self, joints_rad: JointVector, flanks: Sequence[float] | None) -> list[float]:
        sag_rad = self._sag(joints_rad)
        errors_rad = []
        for number, angle_rad in enumerate(joints_rad):
            error_rad = self._offset_rad[number] + sag_rad[number]
            if flanks is not None:
                error_rad += self._half_backlash_rad[number] * flanks[number]
            for order, sine_rad, cosine_rad in zip(HARMONICS, *self._harmonics[number], strict=True):
                error_rad += sine_rad * math.sin(order * angle_rad) + cosine_rad * math.cos(order * angle_rad)
            errors_rad.append(error_rad)
        return errors_rad

    def _sag(self, joints_rad: JointVector) -> list[float]:
        """Return by how much the weight turns each joint, rad; see `gravity_levers`."""
        frames = [Pose(self._chain.base_mm)]
        for joint, link, angle_rad in zip(self._chain.joints, self._nominal_links, joints_rad, strict=True):
            frames.append(frames[-1].compose(_turn(_scaled(joint.axis, angle_rad))).compose(link))
        wrist_x_mm, wrist_y_mm, _ = frames[len(joints_rad) - WRIST_JOINTS].position_mm
        sag_rad = []
        for joint, frame, rad_per_mm in zip(self._chain.joints, frames, self._sag_rad_per_mm, strict=False):
            x_mm, y_mm, _ = frame.position_mm
            axis_x, axis_y, _ = Pose(rotation=frame.rotation).apply(joint.axis)
            sag_rad.append(rad_per_mm * ((wrist_x_mm - x_mm) * axis_y - (wrist_y_mm - y_mm) * axis_x))
        return sag_rad


class Compensation(NamedTuple):
    """Joints that place the flange at the desired pose, and the pose to command."""

    joints_rad: JointVector
    commanded: Pose


class CalibratedArm:
    """Arm model with deviations; identical to the nominal arm if there are none."""

    def __init__(self, nominal: Kinematics, deviations: ArmDeviations | None = None) -> None:
        self.nominal = nominal
        self._deviations = deviations
        self._model = None if deviations is None else PostureModel(nominal.chain, deviations)

    def forward(self, joints_rad: JointVector, flanks: Sequence[float] | None = None) -> Pose:
        """Return the flange pose in the robot base.

        `flanks`, +1 or -1, give the side of its backlash on which each joint rests: the direction in which it
        arrived. Without them, each joint is assumed to be in the middle.
        """
        if self._model is None:
            return self.nominal.forward(joints_rad)
        return self._model.forward(joints_rad, flanks)

    def forward_each(self, joints_rad: Array) -> list[Pose]:
        """Return the poses of `forward` at many joint angles (m, n)."""
        if self._deviations is None:
            return [self.nominal.forward(tuple(row)) for row in joints_rad.tolist()]
        poses = flange_poses(self.nominal.chain, self._deviations, joints_rad)
        turns = poses[:, :3, :3].reshape(-1, 9).tolist()
        return [
            Pose(vector3(place_mm), cast("Rotation9", tuple(turn)))
            for place_mm, turn in zip(poses[:, :3, 3].tolist(), turns, strict=True)
        ]

    def as_controller_sees(self, surroundings: Surroundings, at_rad: JointVector) -> Surroundings:
        """Transform the surroundings into the controller's coordinates, exactly at the given joints.

        The driver of the controller checks clearances with the nominal chain. Within reach of one head the
        deviations vary by some tenths of a millimetre, which margins and corridors allow for.
        """
        if self._model is None:
            return surroundings
        return surroundings.moved(self.nominal.forward(at_rad).compose(self.forward(at_rad).inverse()))

    def flange_pose(self, joints_rad: JointVector, flanks: Sequence[float] | None = None) -> Transform:
        """Return the flange pose as a checked transform, ROBOT <- FLANGE."""
        return self.forward(joints_rad, flanks).to_transform()

    def compensate(
        self, flange: Transform, near: JointVector, flanks: Sequence[float] | None = None
    ) -> Compensation:
        """Find the joints, in the branch of `near`, that place the flange at a pose ROBOT <- FLANGE.

        `flanks` as in `forward`, after arrival. Raises ARM-001 to ARM-003 like `Kinematics.solve_branch`;
        ARM-001 also near a singularity, where no commanded pose leads to the wanted one.
        """
        branch = self.nominal.branch_of(near)
        wanted = Pose.from_transform(flange)
        commanded = wanted
        for _ in range(MOST_ROUNDS):
            joints = self.nominal.solve_branch(commanded, branch, near)
            if self._model is None:
                return Compensation(joints, commanded)
            reached = self.forward(joints, flanks)
            if reached.distance_mm(wanted) < CLOSE_MM and reached.angle_rad(wanted) < CLOSE_RAD:
                return Compensation(joints, commanded)
            commanded = self.nominal.forward(joints).compose(reached.inverse()).compose(wanted)
        raise Unreachable(
            "the calibrated arm does not reach the pose exactly",
            limit=f"{CLOSE_MM} mm after {MOST_ROUNDS} rounds",
            got=f"{reached.distance_mm(wanted):.2g} mm",
        )

    def pose_to_command(
        self,
        pose: Transform,
        flange_from_tool: Transform,
        here_rad: Callable[[], JointVector],
        flanks: Sequence[float] | None = None,
    ) -> Transform:
        """Return the pose to command to the controller so that the tool reaches `pose`.

        `here_rad` measures the joints, in whose branch the arm stays. Raises as `compensate`.
        """
        if self._model is None:
            return pose
        commanded = self.compensate(pose @ flange_from_tool.inverse(), here_rad(), flanks).commanded
        return commanded.to_transform() @ flange_from_tool


def _turn(vector_rad: Vector3) -> Pose:
    """Return a turn by a rotation vector, by Rodrigues' formula."""
    if not (angle_rad := math.hypot(*vector_rad)):
        return Pose()
    x, y, z = (component / angle_rad for component in vector_rad)
    sine, versine = math.sin(angle_rad), 2.0 * math.sin(angle_rad / 2.0) ** 2
    xy, xz, yz = versine * x * y, versine * x * z, versine * y * z
    return Pose(
        rotation=(
            1.0 - versine * (y * y + z * z),
            xy - sine * z,
            xz + sine * y,
            xy + sine * z,
            1.0 - versine * (x * x + z * z),
            yz - sine * x,
            xz - sine * y,
            yz + sine * x,
            1.0 - versine * (x * x + y * y),
        )
    )


def _scaled(vector: Vector3, factor: float) -> Vector3:
    x, y, z = vector
    return (factor * x, factor * y, factor * z)


def _sum(one: Vector3, other: Vector3) -> Vector3:
    return (one[0] + other[0], one[1] + other[1], one[2] + other[2])
