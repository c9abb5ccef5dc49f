"""A camera without distortion, a sphere in front of it, and the stereo head over a sphere of a scene."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from sim.basler.optics.canvas import Area
from sim.basler.optics.sphere import DrawnSphere
from sim.world.displacements import spheres_in_theatre
from sim.world.rigid import apply, inverse, matrix_from, matrix_of, rotation_towards
from sim.world.scene.model import CameraTruth
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import ArmState, World

FOCAL_PX = 11364.0
PRINCIPAL_PX = (1020.0, 540.0)
STRAIGHT = (0.0, 0.0, 0.0, 0.0, 0.0)
RADIUS_MM = 5.75
FULL = Area(0, 0, 2048, 1088)


def bare_camera() -> CameraTruth:
    """The left camera of a scene, without distortion."""
    changes = {
        "focal_px": (FOCAL_PX, FOCAL_PX),
        "principal_point_px": PRINCIPAL_PX,
        "distortion": STRAIGHT,
    }
    return draw_scene("default").left.model_copy(update=changes)


def ball(centre_mm: ArrayLike = (0.0, 0.0, 250.0), rotation: ArrayLike | None = None) -> DrawnSphere:
    """A sphere whose post points away from the camera, unless it is turned otherwise."""
    upright = np.diag([1.0, -1.0, -1.0]) if rotation is None else np.asarray(rotation)
    return DrawnSphere(np.array(centre_mm), RADIUS_MM, upright, 1)


def aim_at_first_sphere(
    world: World, offset_mm: ArrayLike = (0.0, 0.0, 0.0), axis: ArrayLike = (0.0, 0.0, -1.0)
) -> None:
    """Put the true tool centre point on the first sphere, the head looking along an axis."""
    scene = world.scene
    centre = apply(matrix_of(scene.head.robot_from_ct), spheres_in_theatre(scene)[0].centre_ct_mm)
    tool = matrix_from(centre + np.asarray(offset_mm), rotation_towards(axis, (1.0, 0.0, 0.0)))
    flange = tool @ inverse(matrix_of(scene.mount.flange_from_tool_true))
    world.publish_arm(ArmState((0.0,) * 6, flange, 1, True))
