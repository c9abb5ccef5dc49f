"""Random arms of parameter set S, drawn as in the simulated theatre, and their joints at planned poses.

The formulas are those of the simulator's true arm, chain and joints implemented a second time for arrays: a
test compares the two. Every arm is drawn from the seed and its own number. Set S, with spheres 0.38 mm off
their places in the CT (`studies.sphere_errors`), was chosen so that the means of table 4 of the thesis come
out: agreement with that table confirms nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from procedures.registration import error_sources
from ronna_hw.arm.catalogue import find_arm
from ronna_hw.arm.kinematics import Chain, Joint, Kinematics
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.deviations import FLANK_SHARE
from sim.world.descriptions import DESCRIPTIONS
from sim.world.nominal_arm import RobotDescription
from sim.world.scene.as_built import TOOL_IN_FLANGE_MM, draw_arm, draw_mount
from sim.world.scene.model import ArmTruth
from sim.world.true_arm import sag_levers
from studies.errors import POSE_NOT_SOLVED

Components = tuple[Array, Array, Array]
ARMS_KEY = 4  # of the random numbers: arms are independent of everything else drawn from a seed
SETTLED_MM = 1e-5  # far below any source of error; arms twice as bad as set S settle more slowly
STEPS = 10


class Source(StrEnum):
    """Source of target error."""

    TOOL = error_sources.TOOL_FRAME
    LINKS = error_sources.LINKS
    JOINTS = error_sources.HARMONICS
    BACKLASH = error_sources.BACKLASH
    CT = error_sources.CT
    REST = error_sources.SERVO


@dataclass(frozen=True)
class RandomArms:
    """Errors of `a` arms of one model with six joints each, in millimetres and radians."""

    description: RobotDescription
    chain: Chain
    link_translation_mm: Array  # (a, 6, 3)
    link_rotation: Array  # (a, 6, 3, 3)
    joint_offset_rad: Array  # (a, 6)
    harmonics_rad: Array  # (a, 2, 6) once and twice per turn
    phases_rad: Array  # (a, 2, 6)
    sag_rad: Array  # (a, 2) of A2 and A3 at full stretch
    backlash_rad: Array  # (a, 6) the full backlash
    tool_error_mm: Array  # (a, 3) in the flange frame
    repeatability_mm: float  # per axis, at rest

    @classmethod
    def draw(cls, seed: int, numbers: Iterable[int]) -> Self:
        return cls.of([draw_numbered_arm(seed, number) for number in numbers])

    @classmethod
    def of(cls, drawn: list[tuple[ArmTruth, Array]]) -> Self:
        """Build from true arms, each paired with its tool error (3,) in mm."""
        truths = [truth for truth, _ in drawn]
        links = [truth.links for truth in truths]
        turns = np.array([[link.rotation_rad for link in arm] for arm in links])
        return cls(
            description=DESCRIPTIONS[truths[0].variant],
            chain=find_arm(truths[0].variant).kinematics.chain,
            link_translation_mm=np.array([[link.translation_mm for link in arm] for arm in links]),
            link_rotation=Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(-1, 6, 3, 3),
            joint_offset_rad=np.array([truth.joint_offset_rad for truth in truths]),
            harmonics_rad=np.array([(truth.harmonic_1_rad, truth.harmonic_2_rad) for truth in truths]),
            phases_rad=np.array([(one.harmonic_1_phase_rad, one.harmonic_2_phase_rad) for one in truths]),
            sag_rad=np.array([truth.sag_rad for truth in truths]),
            backlash_rad=np.array([truth.backlash_rad for truth in truths]),
            tool_error_mm=np.array([error for _, error in drawn]),
            repeatability_mm=truths[0].repeatability_mm,
        )

    def __len__(self) -> int:
        return len(self.tool_error_mm)

    def only(self, source: Source) -> RandomArms:
        no_turns = np.broadcast_to(np.eye(3), self.link_rotation.shape)
        return replace(
            self,
            tool_error_mm=self.tool_error_mm * (source is Source.TOOL),
            link_translation_mm=self.link_translation_mm * (source is Source.LINKS),
            link_rotation=self.link_rotation if source is Source.LINKS else no_turns,
            joint_offset_rad=self.joint_offset_rad * (source is Source.LINKS),
            harmonics_rad=self.harmonics_rad * (source is Source.JOINTS),
            sag_rad=self.sag_rad * (source is Source.JOINTS),
            backlash_rad=self.backlash_rad * (source is Source.BACKLASH),
            repeatability_mm=self.repeatability_mm * (source is Source.REST),
        )

    def times(self, factors: Array) -> RandomArms:
        """Return arms with all systematic errors larger by a factor (a,) each."""
        turns = Rotation.from_matrix(self.link_rotation.reshape(-1, 3, 3)).as_rotvec()
        larger = Rotation.from_rotvec(np.repeat(factors, len(self.chain.joints))[:, None] * turns).as_matrix()
        flat, deep = factors[:, None], factors[:, None, None]
        return replace(
            self,
            tool_error_mm=flat * self.tool_error_mm,
            link_translation_mm=deep * self.link_translation_mm,
            link_rotation=larger.reshape(self.link_rotation.shape),
            joint_offset_rad=flat * self.joint_offset_rad,
            harmonics_rad=deep * self.harmonics_rad,
            sag_rad=flat * self.sag_rad,
            backlash_rad=flat * self.backlash_rad,
        )

    def tool_points_mm(self, joints_rad: Array, flanks: Array) -> Array:
        """Return true tool positions (a, p, 3) in mm, robot frame, without the repeatability error.

        Encoder angles (a, p, 6); `flanks` (a, p, 6) give the side of its backlash on which each joint rests.
        """
        angles = self._effective_angles_rad(joints_rad, flanks)
        shape = joints_rad.shape[:-1]
        tool = self.tool_error_mm + np.array(TOOL_IN_FLANGE_MM)
        x, y, z = (np.broadcast_to(part[:, None], shape) for part in tool.T)
        point: Components = (x, y, z)
        last = len(self.chain.joints) - 1
        point = multiply(np.reshape(self.chain.flange_rotation, (3, 3)), self._displace_point(last, point))
        for number in reversed(range(last + 1)):
            joint = self.chain.joints[number]
            if number < last:
                point = self._displace_point(number, point)
            point = rotate_about_joint(joint, angles[..., number], translate(point, joint.to_next_mm))
        return np.stack(translate(point, self.chain.base_mm), axis=-1)

    def _displace_point(self, link: int, point: Components) -> Components:
        """Apply a link's error to a point given beyond the link's end."""
        return translate(
            multiply(self.link_rotation[:, None, link], point), self.link_translation_mm[:, None, link]
        )

    def _effective_angles_rad(self, encoders_rad: Array, flanks: Array) -> Array:
        angles = encoders_rad + self.joint_offset_rad[:, None]
        for place, order in enumerate((1, 2)):
            size, phase = self.harmonics_rad[:, None, place], self.phases_rad[:, None, place]
            angles = angles + size * np.sin(order * encoders_rad + phase)
        angles = angles + FLANK_SHARE * self.backlash_rad[:, None] * flanks
        upper, fore = np.cos(encoders_rad[..., 1]), np.cos(encoders_rad[..., 1] + encoders_rad[..., 2])
        of_shoulder, of_elbow = sag_levers(self.description, upper, fore)
        angles[..., 1] += self.sag_rad[:, None, 0] * of_shoulder
        angles[..., 2] += self.sag_rad[:, None, 1] * of_elbow
        return np.asarray(angles)


def draw_numbered_arm(seed: int, number: int) -> tuple[ArmTruth, Array]:
    """Draw a true arm by number, and its tool error (3,) in mm."""
    random = np.random.default_rng(np.random.SeedSequence([seed, ARMS_KEY, number]))
    truth, mount = draw_arm(random), draw_mount(random)
    return truth, np.subtract(mount.flange_from_tool_true.translation_mm, TOOL_IN_FLANGE_MM)


@dataclass(frozen=True)
class PlannedPoses:
    """Postures of the nominal arm: joints (p, 6), and orientations robot <- tool (p, 3, 3).

    `inverse` (p, 6, 6) maps a small motion of the tool (mm, rad) to one of the joints.
    """

    tool_mm: Array  # (3,) in the flange frame, to which the nominal tool is parallel
    joints_rad: Array
    rotations: Array
    inverse: Array

    @classmethod
    def of(cls, kinematics: Kinematics, tool_mm: Array, joints_rad: Array) -> Self:
        """Build from joint vectors (p, 6)."""
        _, rotations = nominal_frames(kinematics.chain, joints_rad, tool_mm)
        inverse = np.empty((len(joints_rad), 6, 6))
        for place, (joints, rotation) in enumerate(zip(joints_rad.tolist(), rotations, strict=True)):
            jacobian = kinematics.jacobian(tuple(joints)).copy()
            jacobian[:3] += np.cross(jacobian[3:].T, rotation @ tool_mm).T
            inverse[place] = np.linalg.inv(jacobian)
        return cls(tool_mm, joints_rad, rotations, inverse)

    def __len__(self) -> int:
        return len(self.joints_rad)


def centre_on_spheres(
    arms: RandomArms, poses: PlannedPoses, spheres_mm: Array, flanks: Array
) -> tuple[Array, Array]:
    """Return joints (a, p, 6) with the true tool at spheres (p, 3), and the believed positions (a, p, 3).

    The believed orientation is the planned one: the servo shifts the tool and does not turn it.
    """
    return solve_joints(
        poses,
        lambda joints: nominal_frames(arms.chain, joints, poses.tool_mm),
        lambda joints, _: spheres_mm - arms.tool_points_mm(joints, flanks),
        (len(arms), len(poses), 6),
    )


def reach_positions(arms: RandomArms, poses: PlannedPoses, places_mm: Array) -> Array:
    """Return joints (a, p, 6) with the nominal tool at positions (a, p, 3), oriented as planned."""
    joints, _ = solve_joints(
        poses,
        lambda joints: nominal_frames(arms.chain, joints, poses.tool_mm),
        lambda _, at: places_mm - at,
        (*places_mm.shape[:-1], 6),
    )
    return joints


def solve_joints(
    poses: PlannedPoses,
    frames: Callable[[Array], tuple[Array, Array]],
    missing: Callable[[Array, Array], Array],
    shape: tuple[int, ...],
) -> tuple[Array, Array]:
    """Solve for joints and tool places with zero `missing` (mm) and the tool oriented as planned.

    An arm ends within millimetres of its planned pose, so the Jacobian of the planned pose serves all arms:
    each step leaves a fiftieth of the error, a tenth near a singularity. The number of steps is fixed, so
    that an arm's result does not depend on the others. `frames` returns the tool's places and orientations
    at joints. Raises STU-009.
    """
    joints = np.array(np.broadcast_to(poses.joints_rad, shape))
    for _ in range(STEPS):
        places, rotations = frames(joints)
        shift = missing(joints, places)
        turn = 0.5 * np.cross(rotations, poses.rotations, axis=-2).sum(axis=-1)
        step = np.concatenate([shift, turn], axis=-1)
        joints = joints + np.einsum("pij,...pj->...pi", poses.inverse, step)
    left_mm = float(np.abs(shift).max())  # before the last step
    if not left_mm < SETTLED_MM:
        raise POSE_NOT_SOLVED(
            f"an arm did not converge in {STEPS} steps", got=f"{left_mm:.2g} mm from its pose"
        )
    return joints, frames(joints)[0]


def nominal_frames(chain: Chain, joints_rad: Array, tool_mm: Array) -> tuple[Array, Array]:
    """Return the nominal arm's tool points (..., 3) in mm and orientations robot <- flange (..., 3, 3).

    `joints_rad` is (..., n), `tool_mm` (3,) in the flange frame.
    """
    flange = np.reshape(chain.flange_rotation, (3, 3))
    one = np.ones(joints_rad.shape[:-1])
    position: Components = tuple(part * one for part in flange @ tool_mm)
    axes: list[Components] = [tuple(part * one for part in flange[:, k]) for k in range(3)]
    for number in reversed(range(len(chain.joints))):
        joint, angle = chain.joints[number], joints_rad[..., number]
        position = rotate_about_joint(joint, angle, translate(position, joint.to_next_mm))
        axes = [rotate_about_joint(joint, angle, axis) for axis in axes]
    position = translate(position, chain.base_mm)
    rotation = np.stack([np.stack(axis, axis=-1) for axis in axes], axis=-1)
    return np.stack(position, axis=-1), rotation


def rotate_about_joint(joint: Joint, angle_rad: Array, point: Components) -> Components:
    """Rotate points about a joint axis by Rodrigues' formula. All arrays must have the same shape."""
    (x, y, z), (ax, ay, az) = point, joint.axis
    cosine, sine = np.cos(angle_rad), np.sin(angle_rad)
    along = (ax * x + ay * y + az * z) * (1.0 - cosine)
    return (
        x * cosine + (ay * z - az * y) * sine + ax * along,
        y * cosine + (az * x - ax * z) * sine + ay * along,
        z * cosine + (ax * y - ay * x) * sine + az * along,
    )


def multiply(matrix: Array, point: Components) -> Components:
    """Multiply points by matrices (..., 3, 3), broadcasting over the leading axes."""
    x, y, z = point
    first, second, third = (
        matrix[..., row, 0] * x + matrix[..., row, 1] * y + matrix[..., row, 2] * z for row in range(3)
    )
    return first, second, third


def translate(point: Components, offset: ArrayLike) -> Components:
    """Add vectors (..., 3) to points, with broadcasting."""
    vector = np.asarray(offset, dtype=float)
    x, y, z = (part + vector[..., axis] for axis, part in enumerate(point))
    return x, y, z
