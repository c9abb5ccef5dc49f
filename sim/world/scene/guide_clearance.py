"""Clearance of the guide on its line to a target, over a head with a face.

Guide, room around the head and the least distance are those of a theatre file by default, as a planner of the
theatre has them. NumPy alone.
"""

from __future__ import annotations

import numpy as np

from ronna_hw.arm.clearance.bodies import Capsule, covering_ellipsoid
from ronna_hw.arm.clearance.pair_distances import segment_distances
from ronna_hw.arm.pose import Pose
from ronna_hw.collision_config import CollisionConfig
from sim.world.head_surface.covering import cover_head
from sim.world.head_surface.parametric_head import ParametricHead
from sim.world.rigid import Matrix, Vector, Vectors, as_point

RESERVE_MM = 1.0  # beyond the planner's clearance: its ellipsoids are of a CT, and differ by as much
PLACES = 3  # along the line: both ends, and halfway for what it passes by
AS_MOUNTED = Pose((0.0, 0.0, 0.0))  # bodies of the guide stay in the tool frame


class GuideClearance:
    """Checks whether the guide stays clear of head, spheres (n, 3) and room; robot frame, mm."""

    def __init__(self, head: ParametricHead, robot_from_ct: Matrix, spheres_mm: Vectors) -> None:
        cranium, face = cover_head(head)
        placed = Pose.from_matrix(robot_from_ct.tolist())
        at_head = Pose(placed.apply(cranium.centre_mm), placed.rotation)
        config = CollisionConfig()
        around = config.build_surroundings(
            config.guide,
            AS_MOUNTED,
            at_head,
            cranium.semi_axes_mm,
            tuple(as_point(one) for one in spheres_mm),
        )
        below = covering_ellipsoid(face.semi_axes_mm, Pose(face.centre_mm))
        obstacles = [one.capsule for one in around.obstacles] + [one.moved(placed) for one in below]
        self._least_mm = around.margin_mm + RESERVE_MM
        self._tool_mm, self._tool_radii_mm = _as_arrays([one.capsule for one in around.tool])
        self._fixed_mm, self._fixed_radii_mm = _as_arrays(obstacles)

    def is_clear(self, orientation: Matrix, held_mm: Vector, approach_mm: float) -> bool:
        """Return whether the guide is clear from `approach_mm` outside to where its tool origin is held."""
        return self.least_mm(orientation, held_mm, approach_mm) >= self._least_mm

    def least_mm(self, orientation: Matrix, held_mm: Vector, approach_mm: float) -> float:
        """Return the least distance between any of the guide's bodies and any obstacle on that line."""
        back = np.linspace(approach_mm, 0.0, PLACES)[:, None] * orientation[:, 2]
        tool = self._tool_mm @ orientation.T + (held_mm - back)[:, None, None, :]  # places, bodies, ends, xyz
        first = np.moveaxis(tool, (2, 3), (0, 1))[..., None]
        second = np.moveaxis(self._fixed_mm, (1, 2), (0, 1))[:, :, None, None, :]
        apart = segment_distances(first[0], first[1], second[0], second[1])
        return float((apart - self._tool_radii_mm[:, None] - self._fixed_radii_mm).min())


def _as_arrays(capsules: list[Capsule]) -> tuple[Vectors, Vector]:
    """Return the ends (n, 2, 3) and the radii (n,) of capsules."""
    return (
        np.array([(one.start_mm, one.end_mm) for one in capsules]),
        np.array([one.radius_mm for one in capsules]),
    )
