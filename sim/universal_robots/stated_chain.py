"""The chain that a controller states, by axes and points: what an arm's calibration record deviates from.

A driver computes with the factory's calibration. A laboratory that measures the arm through this driver finds
what the factory has left, not what the arm deviates by from its model.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sim.universal_robots.kinematics import TrueKinematics
from sim.universal_robots.model import ZEROS
from sim.world.nominal_arm import RobotDescription
from sim.world.rigid import Array, rotation_from_vector, twice_sine_axis

MM_PER_M = 1000.0


@dataclass(frozen=True)
class StatedChain:
    """Chain of an arm with all joints at zero: frames are parallel to the base, as in `RobotDescription`."""

    points_mm: Array  # (n + 1, 3): a point on each axis, and the flange
    axes: Array  # (n, 3)
    flange_rotation: Array  # (3, 3)


def nominal_chain(arm: RobotDescription) -> StatedChain:
    """Return the chain of a model."""
    steps = [joint.origin_mm for joint in arm.joints]
    return StatedChain(
        np.cumsum([*steps, arm.flange_mm], axis=0),
        np.array([joint.axis for joint in arm.joints]),
        rotation_from_vector(arm.flange_turn_rad),
    )


def stated_chain(kinematics: TrueKinematics, arm: RobotDescription) -> StatedChain:
    """Return the chain of Denavit-Hartenberg parameters, however far away their common normals are.

    The point on an axis is the one nearest to where the model has the joint.
    """
    nominal = nominal_chain(arm)
    *frames, flange = kinematics.link_frames(ZEROS)
    points, axes = [], []
    for frame, wanted in zip(frames, nominal.points_mm, strict=False):
        axis = np.array([frame.r02, frame.r12, frame.r22])
        place = MM_PER_M * np.array([frame.x, frame.y, frame.z])
        points.append(place + axis * ((wanted - place) @ axis))
        axes.append(axis)
    end = np.reshape(flange[:9], (3, 3))
    return StatedChain(np.array([*points, MM_PER_M * np.array(flange[9:])]), np.array(axes), end)


def deviations_from(
    stated: StatedChain,
    arm: RobotDescription,
    translations_mm: Array,
    rotations_rad: Array,
    offsets_rad: Array,
) -> tuple[Array, Array]:
    """Return translations (n, 3) and rotation vectors (n, 3) of the links, from a stated chain to a true arm.

    Arguments are those from the model: `offsets_rad` of the joints, which the result contains in the links,
    and the links' errors at their far ends, in the frame that turns with the joint. Every axis of the stated
    chain is the model's, turned by the smallest rotation.
    """
    nominal = nominal_chain(arm)
    turned = [_smallest_rotation(a, b) for a, b in zip(nominal.axes, stated.axes, strict=True)]
    turned.append(stated.flange_rotation @ nominal.flange_rotation.T)
    links_mm, stated_mm = np.diff(nominal.points_mm, axis=0), np.diff(stated.points_mm, axis=0)
    shifts, turns = [], []
    for number, (axis, offset) in enumerate(zip(nominal.axes, offsets_rad, strict=True)):
        here = turned[number] @ rotation_from_vector(offset * axis)
        shifts.append(here @ (links_mm[number] + translations_mm[number]) - stated_mm[number])
        turns.append(_small_vector(here @ rotation_from_vector(rotations_rad[number]) @ turned[number + 1].T))
    # Both begin on the first axis, along which the stated one may begin elsewhere.
    shifts[0] = shifts[0] + nominal.points_mm[0] - stated.points_mm[0]
    return np.array(shifts), np.array(turns)


def _smallest_rotation(one: Array, other: Array) -> Array:
    """Return the rotation that brings a unit vector to a nearby one about an axis across both."""
    across = np.cross(one, other)
    sine = float(np.linalg.norm(across))
    if sine == 0.0:
        return np.eye(3)
    angle = float(np.arctan2(sine, one @ other))
    return rotation_from_vector(across * (angle / sine))


def _small_vector(rotation: Array) -> Array:
    """Return the rotation vector of a small rotation, with all digits."""
    twice_sine = twice_sine_axis(rotation)
    sine = float(np.linalg.norm(twice_sine)) / 2.0
    return twice_sine / 2.0 * (np.arcsin(sine) / sine if sine > 0.0 else 1.0)
