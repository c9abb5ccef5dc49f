"""A user's CT as the head of a scene: its place, its size and trajectories into it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim.errors import BAD_SCENE
from sim.world.head_surface.volume_head import VolumeHead, read_head
from sim.world.rigid import Vector, as_rounded_point, matrix_from, matrix_of, pose_of
from sim.world.scene.model import Head, Scene
from sim.world.scene.parts import Target
from sim.world.scene.skin import FAR_MM

VERTEX_MM = 90.0  # of an adult above the middle of the cranium, as in a drawn head
BESIDE_MM = (40.0, 150.0)  # plausible distances of the skin from that middle
ROUNDS = 3  # of finding the middle from rays out of the present one


def with_own_head(scene: Scene, series: Path) -> Scene:
    """Return a scene drawn without spheres whose head is this CT, where the drawn one was; raises SIM-001.

    Trajectories keep their directions from the middle of the head, and their depths.
    """
    drawn, own = scene.head, read_head(series)
    centre, semi_axes = _measure(own)
    there = matrix_of(drawn.robot_from_ct)
    rotation = there[:3, :3]
    middle = rotation @ np.array(drawn.centre_ct_mm) + there[:3, 3]
    head = Head(
        robot_from_ct=pose_of(matrix_from(middle - rotation @ centre, rotation)),
        centre_ct_mm=as_rounded_point(centre),
        semi_axes_mm=as_rounded_point(semi_axes),
        own_ct=str(series.resolve()),
        fiducials=(),
        robot_from_patient_frame=drawn.robot_from_patient_frame,
        targets=tuple(_move_target(one, drawn, own, centre) for one in drawn.targets),
    )
    return scene.model_copy(update={"head": head})


def _measure(own: VolumeHead) -> tuple[Vector, Vector]:
    """Return middle and semi-axes of the cranium."""
    low, high = own.extent_mm
    centre = np.array([*(0.5 * (low + high))[:2], high[2] - VERTEX_MM])
    sides = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
    for _ in range(ROUNDS):
        left, right, back, front = np.clip(_reach(own, centre, sides), *BESIDE_MM)
        centre = np.add(centre, (0.5 * (left - right), 0.5 * (back - front), 0.0))
    return centre, np.array([0.5 * (left + right), 0.5 * (back + front), VERTEX_MM])


def _reach(own: VolumeHead, centre: Vector, directions: Vector) -> Vector:
    """Return the distances (n,) of the skin from the middle, as seen from outside; raises SIM-001."""
    reach = FAR_MM - own.cast(centre + FAR_MM * directions, -directions, FAR_MM)
    if np.isnan(reach).any():
        raise BAD_SCENE("the CT shows no head that a cranium could be fitted to", expected="a whole cranium")
    return np.asarray(reach)


def _move_target(target: Target, drawn: Head, own: VolumeHead, centre: Vector) -> Target:
    entry = np.subtract(target.entry_ct_mm, drawn.centre_ct_mm)
    direction = entry / np.linalg.norm(entry)
    moved = centre + _reach(own, centre, direction[None])[0] * direction
    inward = np.subtract(target.target_ct_mm, target.entry_ct_mm)
    return target.model_copy(
        update={"entry_ct_mm": as_rounded_point(moved), "target_ct_mm": as_rounded_point(moved + inward)}
    )
