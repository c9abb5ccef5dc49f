"""Two placed arms: how close they may come, and each as an obstacle of the other.

The bodies of each arm are its own (`Bodies`), in postures of its own kinematics.

Lengths in mm. The common frame is the base of the master; `base` of an arm leads there.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ronna_hw.arm.clearance.bodies import Bodies, Capsule, Obstacle
from ronna_hw.arm.clearance.sweep import moving_ends
from ronna_hw.arm.kinematics import COLUMN_NAME
from ronna_hw.arm.pose import Pose
from ronna_hw.arrays import Array
from ronna_hw.vectors import JointVector, vector3

# Safety against two arms that meet (U).
APART_MM = 30.0  # between the arms, at any moment
PLANNED_APART_MM = 40.0  # along planned paths: the rest is for the errors of both arms and their bases
# Between the assistant and a guide that it leads an instrument to: it is slow there, and was seen within a
# millimetre of where its joints have it. Planned paths keep the same reserve beyond that.
# Safety against two arms that meet at the guide (U).
APART_AT_GUIDE_MM = 10.0


class Closeness(NamedTuple):
    """Pairs of bodies, one of each arm, that may come closer than the arms otherwise.

    `contacts` are pairs of a body of the first arm and one of the second, by name, that may touch. All of the
    second may come as close to the bodies `near` of the first as to a guide.
    """

    contacts: frozenset[tuple[str, str]] = frozenset()
    near: frozenset[str] = frozenset()

    def allowance_mm(self, first: str, second: str) -> float:
        """Return by how much a pair of bodies may come closer, mm; infinite if it may touch."""
        if (first, second) in self.contacts:
            return np.inf
        return APART_MM - APART_AT_GUIDE_MM if first in self.near else 0.0


NO_CLOSENESS = Closeness()


@dataclass(frozen=True)
class PlacedArm:
    """An arm with its tool, and where it stands: ROBOT of the master <- its own base."""

    name: str
    bodies: Bodies
    base: Pose

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all bodies: column, links, tool."""
        return (COLUMN_NAME, *self.bodies.moving_names)

    @cached_property
    def radii_mm(self) -> tuple[float, ...]:
        """Radii of all bodies."""
        return (self.bodies.fixed[0].radius_mm, *self.bodies.moving_radii_mm)

    @cached_property
    def levers_mm(self) -> JointVector:
        """Upper bounds on the motion of any point, in mm per radian of each joint."""
        ends = [end for part in self.bodies.surroundings.tool for end in part.capsule[:2]]
        return self.bodies.arm.levers_mm(ends)

    def axes(self, joints_rad: Array) -> Array:
        """Return the axis ends of all bodies in the common frame, (n, bodies, 2, 3)."""
        joints = np.atleast_2d(joints_rad)
        column = self.bodies.fixed[0]
        fixed = np.broadcast_to([column.start_mm, column.end_mm], (len(joints), 1, 2, 3))
        ends = np.concatenate([fixed, moving_ends(self.bodies, joints)], axis=1)
        turn = np.reshape(self.base.rotation, (3, 3))
        return np.asarray(ends @ turn.T + np.array(self.base.position_mm))

    def as_obstacles(
        self, joints_rad: JointVector, seen_from: Pose, grown_mm: float, near: Collection[str] = ()
    ) -> tuple[Obstacle, ...]:
        """Return the arm at rest as obstacles of another arm with base `seen_from`, thicker by `grown_mm`.

        All of that arm may come as close to the bodies `near`, by name, as to a guide.
        """
        to_other, closer_mm = seen_from.inverse(), APART_MM - APART_AT_GUIDE_MM
        axes, obstacles = self.axes(np.array([joints_rad]))[0], []
        for name, radius, (start, end) in zip(self.names, self.radii_mm, axes, strict=True):
            radius_mm = radius + grown_mm - (closer_mm if name in near else 0.0)
            capsule = Capsule(vector3(start), vector3(end), radius_mm).moved(to_other)
            obstacles.append(Obstacle(name_of(name, self.name), capsule))
        return tuple(obstacles)


def name_of(body: str, arm: str) -> str:
    """Return the name of a body of one arm as an obstacle of the other."""
    return f"{body} of the {arm}"


class ArmDistance(NamedTuple):
    """Smallest distance between two arms, and the two bodies."""

    distance_mm: float
    first: str
    second: str
