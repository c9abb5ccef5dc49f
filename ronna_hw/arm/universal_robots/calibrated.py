"""`Kinematics` of one individual arm, with the factory's calibration.

Forward kinematics multiply out the individual chain. The inverse has no closed form, as wrist and parallel
axes are not quite what it assumes. It iterates that of the nearest arm with axes exactly parallel and square:
the pose asked for is corrected by what that arm and this one differ at the joints found so far. The error
shrinks a hundredfold or more with every step, less near singular postures, and the branch is kept.

Next to known joint angles, as from one set-point to the next, `LocalInverse` is several times faster.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from math import hypot, sqrt
from typing import TYPE_CHECKING

from ronna_hw.arm.errors import Singular
from ronna_hw.arm.kinematics import Branch, Chain, Joint, Segment
from ronna_hw.arm.pose import Pose
from ronna_hw.arm.universal_robots import inverse
from ronna_hw.arm.universal_robots.factory_calibration import ZEROS, FactoryCalibration, reduce_chain
from ronna_hw.arm.universal_robots.geometry import Dimensions
from ronna_hw.arm.universal_robots.kinematics import UniversalRobot, chain_frames, chain_jacobian
from ronna_hw.arm.universal_robots.local_inverse import LocalInverse
from ronna_hw.vectors import JointVector, Vector3, joint_vector

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

CONVERGED_MM = 5e-10
CONVERGED_RAD = 1e-12
STEPS_LIMIT = 40  # two digits a step, or fewer near singular postures


class CalibratedUniversalRobot(UniversalRobot):
    """Kinematics of the arm that a factory calibration describes. Branches are the nominal arm's."""

    def __init__(self, dimensions: Dimensions, calibration: FactoryCalibration) -> None:
        self._transforms = reduce_chain(dimensions, calibration)
        super().__init__(_parallel_arm(dimensions, self._transforms))
        self.chain = _parallel_chain(self._transforms, self.dimensions.d1_mm)
        *inner, hand = self.links
        self.links = (*inner, hand._replace(end_mm=self.chain.joints[hand.joint].to_next_mm))
        self._segments = self._link_ends()
        self.local_inverse = LocalInverse(self.dimensions, self._transforms)

    def forward(self, joints_rad: JointVector) -> Pose:
        """Return the flange pose in the base; z points out of the flange."""
        return chain_frames(self._transforms, joints_rad)[1]

    def jacobian(self, joints_rad: JointVector) -> NDArray[np.float64]:
        return chain_jacobian(self._transforms, joints_rad)

    def closed_form(self, pose: Pose, branch: Branch) -> JointVector:
        """Return the joint angles of a branch, up to whole turns, iterated from the closed form.

        Raises ARM-001 or ARM-002 as the nominal arm does, and ARM-002 where the iteration does not converge:
        within a few mm or mrad of a singular posture.
        """
        corrected = pose
        for _ in range(STEPS_LIMIT):
            joints = inverse.closed_form(self.dimensions, corrected, branch, guess=True)
            reached = self.forward(joints)
            if reached.distance_mm(pose) < CONVERGED_MM and _turned_rad(reached, pose) < CONVERGED_RAD:
                return joints
            corrected = super().forward(joints).compose(reached.inverse().compose(pose))
        super().closed_form(corrected, branch)  # out of reach: raises ARM-001
        raise Singular(
            "no joint angles converge at this pose",
            limit=f"{CONVERGED_MM:g} mm",
            got=f"{reached.distance_mm(pose):.2e} mm",
        )

    def solve_branch(self, pose: Pose, branch: Branch, near: JointVector) -> JointVector:
        found = self.local_inverse.solve(pose, branch, near)
        return super().solve_branch(pose, branch, near) if found is None else found

    def link_segments(self, joints_rad: JointVector) -> tuple[list[Segment], Pose]:
        frames, flange = chain_frames(self._transforms, joints_rad)
        return [
            (frames[joint].apply(start), frames[joint].apply(end)) for joint, start, end in self._segments
        ], flange

    def levers_mm(self, tool_points_mm: Sequence[Vector3]) -> JointVector:
        tool_mm = max((hypot(*point) for point in tool_points_mm), default=0.0)
        extent_mm = self.dimensions.reach_mm + self.dimensions.d6_mm + tool_mm
        pairs = list(zip(self._transforms, self.dimensions.links, strict=True))
        away_mm = sum(one.distance_mm(nominal) + extent_mm * one.angle_rad(nominal) for one, nominal in pairs)
        return joint_vector(lever + away_mm for lever in super().levers_mm(tool_points_mm))

    def _link_ends(self) -> list[tuple[int, Vector3, Vector3]]:
        """Return the ends of the links in the frames of `chain_frames`, which at zero are not parallel."""
        zero, _ = chain_frames(self._transforms, ZEROS)
        ends = []
        for link in self.links:
            frame = zero[link.joint]
            origin = self.chain.base_mm if link.joint == 0 else frame.position_mm
            back, parallel = frame.inverse(), Pose(origin)
            start, end = (back.apply(parallel.apply(point)) for point in (link.start_mm, link.end_mm))
            ends.append((link.joint, start, end))
        return ends


def _turned_rad(a: Pose, b: Pose) -> float:
    """Return the angle between two nearly equal orientations, from the difference of their matrices."""
    return sqrt(sum((x - y) ** 2 for x, y in zip(a.rotation, b.rotation, strict=True)) / 2.0)


def _parallel_arm(nominal: Dimensions, transforms: tuple[Pose, ...]) -> Dimensions:
    """Return the dimensions of the arm with exactly parallel and square axes that is nearest."""
    base, upper, fore, wrist_1, wrist_2, wrist_3 = (transform.position_mm for transform in transforms)
    return replace(
        nominal,
        a2_mm=-hypot(upper[0], upper[1]),
        a3_mm=-hypot(fore[0], fore[1]),
        d1_mm=base[2],
        d4_mm=upper[2] + fore[2] + wrist_1[2],
        d5_mm=wrist_2[2],
        d6_mm=wrist_3[2],
    )


def _parallel_chain(transforms: tuple[Pose, ...], shoulder_mm: float) -> Chain:
    """Describe the same chain by axes and displacements in the base, all joints at zero."""
    frames, flange = chain_frames(transforms, ZEROS)
    base = (0.0, 0.0, shoulder_mm)  # on the first axis
    origins = (base, *(frame.position_mm for frame in frames[1:]), flange.position_mm)
    joints = []
    for frame, (x, y, z), (to_x, to_y, to_z) in zip(frames, origins[:-1], origins[1:], strict=True):
        r = frame.rotation
        joints.append(Joint((r[2], r[5], r[8]), (to_x - x, to_y - y, to_z - z)))
    return Chain(base, tuple(joints), flange.rotation)
