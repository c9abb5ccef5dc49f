"""Feasibility of a drawn plan for the arm, as required of every drawn scene.

A trajectory is feasible if, at some turn about its axis, the arm reaches all poses in one posture, each from
a point above. The poses: the tool at every sphere in the orientation of the trajectory, the guide before the
entry, and the stereo head at the target, for a phantom with a ball there. At that turn no sphere may be in
front of or behind another one in either camera, and over a head with a face the guide must be clear on its
line. Robot frame, mm.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import pi, radians
from typing import TYPE_CHECKING

import numpy as np

from sim.world.descriptions import DESCRIPTIONS
from sim.world.rigid import Vector, inverse, matrix_from
from sim.world.scene.as_built import CAMERAS_IN_TOOL_MM, TOOL_IN_FLANGE_MM
from sim.world.scene.parts import Guide

if TYPE_CHECKING:
    from sim.world.scene.guide_clearance import GuideClearance

APPROACH_MM = 60.0  # distance of the tool outside sphere or skin
STANDOFF_MM = 30.0  # distance of the guide from the entry, in the plan of a phantom
TURN_STEP_RAD, FURTHEST_TURN_RAD = radians(10.0), radians(90.0)
MARGIN_RAD = radians(3.0)  # from the end switches: a coarse registration is off by millimetres
SPHERE_MM = 5.75  # radius
BESIDE_MM = 4.0  # clearance around each sphere, a millimetre more than the planner requires


class PlanFeasibility:
    """Checks whether trajectories are feasible for an arm that must also measure the spheres (n, 3).

    `clearance` is that of the guide over a head with a face. Without one it is not checked.
    """

    def __init__(self, spheres_mm: Vector, variant: str, clearance: GuideClearance | None = None) -> None:
        self._arm = DESCRIPTIONS[variant]
        # Joints that turn more than a full circle reach every angle.
        self._limited = [
            (number, radians(joint.lower_deg) + MARGIN_RAD, radians(joint.upper_deg) - MARGIN_RAD)
            for number, joint in enumerate(self._arm.joints)
            if radians(joint.upper_deg - joint.lower_deg) < 2.0 * (pi + MARGIN_RAD)
        ]
        self._spheres_mm, self._clearance = spheres_mm, clearance
        self._tool_from_flange = inverse(matrix_from(TOOL_IN_FLANGE_MM, np.eye(3)))
        self._known: dict[tuple[int, bytes], bool] = {}
        self._clear: dict[bytes, bool] = {}

    def is_feasible(self, trajectories: Sequence[tuple[Vector, Vector]]) -> bool:
        """Return whether one posture reaches all trajectories, given as entry (3,) and target (3,)."""
        return any(
            all(self._is_trajectory_reachable(*ends, posture) for ends in trajectories)
            for posture in self._arm.make.postures
        )

    def _is_trajectory_reachable(self, entry_mm: Vector, target_mm: Vector, posture: int) -> bool:
        key = posture, entry_mm.tobytes() + target_mm.tobytes()
        if key not in self._known:
            to_target_mm = target_mm - entry_mm
            depth_mm = float(np.linalg.norm(to_target_mm))
            axis = to_target_mm / depth_mm
            places = [(point, APPROACH_MM) for point in self._spheres_mm]
            places.append((target_mm, depth_mm + APPROACH_MM))
            held_mm = entry_mm + (Guide().reach_mm - STANDOFF_MM) * axis
            places.append((held_mm, APPROACH_MM))
            tips = np.array(
                [tip for place, retreat_mm in places for tip in (place, place - retreat_mm * axis)]
            )
            self._known[key] = any(
                self._is_each_sphere_visible(orientation)
                and self._is_guide_clear(orientation, held_mm)
                and all(
                    self._is_within_ranges(matrix_from(tip, orientation) @ self._tool_from_flange, posture)
                    for tip in tips
                )
                for orientation in _list_orientations(axis, target_mm)
            )
        return self._known[key]

    def _is_guide_clear(self, orientation: Vector, held_mm: Vector) -> bool:
        if self._clearance is None:
            return True
        key = orientation.tobytes() + held_mm.tobytes()
        if key not in self._clear:  # asked again in every posture
            self._clear[key] = self._clearance.is_clear(orientation, held_mm, APPROACH_MM)
        return self._clear[key]

    def _is_each_sphere_visible(self, orientation: Vector) -> bool:
        """Return whether both cameras, aimed at each sphere in turn, see it clear of the other spheres."""
        others = ~np.eye(len(self._spheres_mm), dtype=bool)
        for camera_mm in CAMERAS_IN_TOOL_MM:
            eyes = self._spheres_mm + orientation @ np.array(camera_mm)
            rays = self._spheres_mm[None] - eyes[:, None]
            distances = np.linalg.norm(rays, axis=2)
            radii = np.arcsin(np.minimum(1.0, (SPHERE_MM + BESIDE_MM) / distances))
            directions = rays / distances[:, :, None]
            aimed_sphere = np.einsum("ijk,ik->ij", directions, np.einsum("iik->ik", directions))
            gaps = np.arccos(np.clip(aimed_sphere, -1.0, 1.0)) - radii - np.diag(radii)[:, None]
            if (gaps[others] < 0.0).any():
                return False
        return True

    def _is_within_ranges(self, flange: Vector, posture: int) -> bool:
        axes = self._arm.make.axes(self._arm, flange, posture)
        if axes is None:
            return False
        for number, low, high in self._limited:
            angle = (axes[number] + pi) % (2.0 * pi) - pi
            if not (low <= angle <= high or low <= angle - 2.0 * pi):
                return False
        return True


def _list_orientations(axis: Vector, at_mm: Vector) -> Iterator[Vector]:
    """Yield rotations robot <- tool with z along the trajectory, nearest first to x away from the base."""
    radial = np.array([at_mm[0], at_mm[1], 0.0])
    across = radial - axis * float(axis @ radial)
    x_zero = across / np.linalg.norm(across)
    y_zero = np.cross(axis, x_zero)
    steps = round(FURTHEST_TURN_RAD / TURN_STEP_RAD)
    for step in sorted(range(-steps, steps + 1), key=abs):
        turn = step * TURN_STEP_RAD
        x = np.cos(turn) * x_zero + np.sin(turn) * y_zero
        yield np.column_stack([x, np.cross(axis, x), axis])
