"""Deviations of an arm from its nominal chain, and compensation of commanded poses.

The effective angle of a joint is

    q + offset + sum over k = 1, 2 of (s_k sin kq + c_k cos kq) + sag g(q) + backlash / 2 * flank

where `flank`, -1 to 1, is the side from which the joint arrived, and g(q) the horizontal lever arm of the
wrist about the joint, relative to that of the stretched arm. At its far end every link is displaced by a
small translation and a small rotation.

A controller knows only the nominal chain. It is given an offset pose, from which the deviations lead to the
wanted one. They are small and smooth, so each iteration leaves a thousandth of the error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.errors import Unreachable
from ronna_hw.arm.kinematics import Chain, Kinematics
from ronna_hw.arm.pose import Pose
from ronna_hw.calibration import ArmCalibration
from ronna_hw.frames import Transform
from ronna_hw.vectors import JointVector

Array = NDArray[np.float64]
HARMONICS = (1, 2)  # per turn of a joint
FLANK_SHARE = 0.5  # of the backlash, to either side
CLOSE_MM = 1e-5  # resolution of a record's numbers
CLOSE_RAD = 1e-8
MOST_ROUNDS = 8  # four suffice for an uncalibrated arm away from singularities


@dataclass(frozen=True)
class ArmDeviations:
    """Deviations of an arm with n joints, from the base outwards, in mm and rad."""

    link_translation_mm: Array  # (n, 3) at the far end of the link after each joint, in its frame
    link_rotation_rad: Array  # (n, 3) there
    joint_offset_rad: Array  # (n,)
    sine_rad: Array  # (n, 2) once and twice per turn
    cosine_rad: Array  # (n, 2)
    sag_rad: Array  # (n,) of the stretched arm
    backlash_rad: Array  # (n,) the full backlash

    @classmethod
    def none(cls, joints: int) -> Self:
        """Return zero deviations: the nominal arm."""
        each, per_axis = np.zeros(joints), np.zeros((joints, 3))
        per_turn = np.zeros((joints, len(HARMONICS)))
        return cls(per_axis, per_axis, each, per_turn, per_turn, each, each)

    @classmethod
    def of(cls, record: ArmCalibration) -> Self:
        """Extract the deviations from a calibration record."""
        return cls(*(np.array(getattr(record, field.name)) for field in fields(cls)))

    def as_plain(self) -> dict[str, Any]:
        """Return the values keyed by their names in a calibration record."""
        plain: dict[str, Any] = {}
        for field in fields(self):
            values = getattr(self, field.name)
            plain[field.name] = tuple(values.tolist() if values.ndim == 1 else map(tuple, values.tolist()))
        return plain

    def flat(self) -> Array:
        """Concatenate all values into one vector, field by field."""
        return np.concatenate([np.ravel(getattr(self, field.name)) for field in fields(self)])

    @classmethod
    def from_flat(cls, row: Array, joints: int) -> Self:
        """Restore the deviations from a `flat` vector."""
        parts, begin = [], 0
        for field in fields(cls):
            shape = getattr(cls.none(joints), field.name).shape
            end = begin + int(np.prod(shape))
            parts.append(row[begin:end].reshape(shape))
            begin = end
        return cls(*parts)


class Compensation(NamedTuple):
    """Joints that place the flange at the desired pose, and the pose to command."""

    joints_rad: JointVector
    commanded: Pose


class CalibratedArm:
    """Arm model with deviations; identical to the nominal arm if there are none."""

    def __init__(self, nominal: Kinematics, deviations: ArmDeviations | None = None) -> None:
        self.nominal = nominal
        self._deviations = deviations

    @property
    def is_nominal(self) -> bool:
        """Whether the arm has no known deviations."""
        return self._deviations is None

    def forward(self, joints_rad: JointVector, flanks: Sequence[float] | None = None) -> Pose:
        """Return the flange pose in the robot base.

        `flanks`, +1 or -1, give the side of its backlash on which each joint rests: the direction in which it
        arrived. Without them, each joint is assumed to be in the middle.
        """
        if self._deviations is None:
            return self.nominal.forward(joints_rad)
        sides: ArrayLike = 0.0 if flanks is None else np.asarray(flanks, dtype=float)
        pose = flange_poses(self.nominal.chain, self._deviations, joints_rad, sides)[0]
        return Pose.from_matrix(pose.tolist())

    def as_controller_sees(self, surroundings: Surroundings, at_rad: JointVector) -> Surroundings:
        """Transform the surroundings into the controller's coordinates, exactly at the given joints.

        The driver of the controller checks clearances with the nominal chain. Within reach of one head the
        deviations vary by some tenths of a millimetre, which margins and corridors allow for.
        """
        if self._deviations is None:
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
            if self._deviations is None:
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


def flange_poses(
    chain: Chain,
    deviations: ArmDeviations,
    joints_rad: ArrayLike,
    flanks: ArrayLike = 0.0,
    levers: Array | None = None,
) -> Array:
    """Return poses (m, 4, 4) ROBOT <- FLANGE at encoder angles (m, n), with backlash sides `flanks` (m, n).

    `levers` are the `gravity_levers` at these angles, if known.
    """
    encoders = np.atleast_2d(np.asarray(joints_rad, dtype=float))
    effective_rad = encoders + joint_errors(chain, deviations, encoders, flanks, levers)
    place = np.tile(chain.base_mm, (len(encoders), 1))
    turned = np.tile(np.eye(3), (len(encoders), 1, 1))  # robot <- link
    link_turns = rotations(deviations.link_rotation_rad)
    for number, joint in enumerate(chain.joints):
        turned = turned @ rotations(effective_rad[:, number, None] * np.array(joint.axis))
        place = place + turned @ (np.array(joint.to_next_mm) + deviations.link_translation_mm[number])
        turned = turned @ link_turns[number]
    poses = np.zeros((len(encoders), 4, 4))
    poses[:, :3, :3] = turned @ np.reshape(chain.flange_rotation, (3, 3))
    poses[:, :3, 3], poses[:, 3, 3] = place, 1.0
    return poses


def flange_rotations(chain: Chain, joints_rad: Array) -> Array:
    """Return orientations (m, 3, 3) ROBOT <- FLANGE of the nominal arm."""
    nominal = ArmDeviations.none(len(chain.joints))
    return np.asarray(flange_poses(chain, nominal, joints_rad)[:, :3, :3])


def joint_errors(
    chain: Chain,
    deviations: ArmDeviations,
    encoders_rad: Array,
    flanks: ArrayLike,
    levers: Array | None = None,
) -> Array:
    """Return the differences between effective and encoder angles, (m, n) rad."""
    errors = deviations.joint_offset_rad + FLANK_SHARE * deviations.backlash_rad * np.asarray(flanks)
    if levers is None:
        levers = gravity_levers(chain, encoders_rad)
    errors = errors + deviations.sag_rad * levers
    for column, order in enumerate(HARMONICS):
        errors = errors + deviations.sine_rad[:, column] * np.sin(order * encoders_rad)
        errors = errors + deviations.cosine_rad[:, column] * np.cos(order * encoders_rad)
    return np.asarray(errors)


def gravity_levers(chain: Chain, joints_rad: Array) -> Array:
    """Return horizontal lever arms (m, n) of the wrist about each joint, relative to the stretched arm's.

    Positive where weight turns the joint in its positive direction; 0 for the wrist joints.
    """
    places, axes = [], []
    place = np.tile(chain.base_mm, (len(joints_rad), 1))
    turned = np.tile(np.eye(3), (len(joints_rad), 1, 1))
    for number, joint in enumerate(chain.joints):
        places.append(place)
        axes.append(turned @ np.array(joint.axis))
        turned = turned @ rotations(joints_rad[:, number, None] * np.array(joint.axis))
        place = place + turned @ np.array(joint.to_next_mm)
    wrist = len(chain.joints) - 2
    levers = np.zeros_like(joints_rad)
    for number in range(wrist):
        x_mm, y_mm, _ = (places[wrist] - places[number]).T
        axis_x, axis_y, _ = axes[number].T
        # Stretched, all links are across the axis; what lies along it has no lever.
        across = [np.cross(chain.joints[number].axis, one.to_next_mm) for one in chain.joints[number:wrist]]
        stretched_mm = sum(float(np.linalg.norm(link)) for link in across)
        if stretched_mm > 0.0:
            levers[:, number] = (x_mm * axis_y - y_mm * axis_x) / stretched_mm
    return levers


def rotations(vectors_rad: Array) -> Array:
    """Convert rotation vectors (m, 3) to matrices (m, 3, 3) by Rodrigues' formula."""
    angles = np.linalg.norm(vectors_rad, axis=1)
    x, y, z = vectors_rad.T / np.where(angles > 0.0, angles, 1.0)
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    sine, versine = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))
