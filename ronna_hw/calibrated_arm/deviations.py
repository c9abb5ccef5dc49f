"""Deviations of an arm from its nominal chain.

The effective angle of a joint is

    q + offset + sum over k = 1, 2 of (s_k sin kq + c_k cos kq) + sag g(q) + backlash / 2 * flank

where `flank`, -1 to 1, is the side from which the joint arrived, and g(q) the horizontal lever arm of the
wrist about the joint, relative to that of the stretched arm. At its far end every link is displaced by a
small translation and a small rotation.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cache
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike

from ronna_hw.arm.kinematics import Chain
from ronna_hw.arrays import Array
from ronna_hw.calibration import ArmCalibration

HARMONICS = (1, 2)  # per turn of a joint
WRIST_JOINTS = 2  # the last ones, which carry no lever worth counting
FLANK_SHARE = 0.5  # of the backlash, to either side


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
    wrist = len(chain.joints) - WRIST_JOINTS
    levers = np.zeros_like(joints_rad)
    for number, length_mm in enumerate(stretched_mm(chain)):
        if length_mm > 0.0:
            x_mm, y_mm, _ = (places[wrist] - places[number]).T
            axis_x, axis_y, _ = axes[number].T
            levers[:, number] = (x_mm * axis_y - y_mm * axis_x) / length_mm
    return levers


@cache
def stretched_mm(chain: Chain) -> tuple[float, ...]:
    """Return how far the wrist of the stretched arm is from each joint; 0 for the wrist joints.

    Stretched, all links are across the axis of the joint; what lies along it has no lever.
    """
    wrist = len(chain.joints) - WRIST_JOINTS
    across = (
        [np.cross(joint.axis, link.to_next_mm) for link in chain.joints[number:wrist]]
        for number, joint in enumerate(chain.joints)
    )
    return tuple(float(sum(np.linalg.norm(link) for link in links)) for links in across)


def rotations(vectors_rad: Array) -> Array:
    """Convert rotation vectors (m, 3) to matrices (m, 3, 3) by Rodrigues' formula."""
    angles = np.linalg.norm(vectors_rad, axis=1)
    x, y, z = vectors_rad.T / np.where(angles > 0.0, angles, 1.0)
    zero = np.zeros_like(x)
    cross = np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]]).transpose(2, 0, 1)
    sine, versine = np.sin(angles)[:, None, None], (1.0 - np.cos(angles))[:, None, None]
    return np.asarray(np.eye(3) + sine * cross + versine * (cross @ cross))
