"""An x-shaped frame on the head: two crossed bars on a foot, a sphere at each end."""

from __future__ import annotations

from math import pi, radians

import numpy as np
from numpy.typing import NDArray

from ronna_hw.x_frame import (
    BAR_BELOW_MM,
    BAR_RADIUS_MM,
    BARS,
    CLOSE_SPHERE_CENTRES_MM,
    FOOT_RADIUS_MM,
    SPHERE_CENTRES_MM,
    STANDOFF_MM,
)
from sim.errors import BadScene
from sim.phantom.head.anatomy import FLANGE_MM, Marker, marker_on_foot, marker_on_post, shifted
from sim.phantom.head.obstacles import skin_point
from sim.phantom.head.shapes import Point, Rod, Shape
from sim.world.rigid import rotation_towards
from sim.world.scene.head import CAP_AXIS_CT
from sim.world.scene.model import Fiducial, Head

Vector = NDArray[np.float64]

FREE, XFRAME, XFRAME_CLOSE = "free", "xframe", "xframe-close"
FRAMES = {XFRAME: SPHERE_CENTRES_MM, XFRAME_CLOSE: CLOSE_SPHERE_CENTRES_MM}
SPHERES = 4

TILT_RAD = radians(20.0)  # of the foot from the middle of the cap
BAR_HU = (260.0, 2500.0)  # plastic or aluminium
FOOT_HU, FOOT_IN_SKULL_MM = 3500.0, 10.0
ATTEMPTS = 200


def frame_fiducials(head: Head, frame: str, generator: np.random.Generator) -> tuple[Fiducial, ...]:
    """Where the frame's spheres are; raises SIM-001 if it is not clear of the head."""
    in_frame = np.array(FRAMES[frame])
    axis = np.array(CAP_AXIS_CT) / np.linalg.norm(CAP_AXIS_CT)
    for _ in range(ATTEMPTS):
        direction = axis + np.tan(TILT_RAD) * generator.uniform(-1.0, 1.0, 3)
        skin, normal = skin_point(head, direction)
        turn = generator.uniform(0.0, 2.0 * pi)
        hint = np.array([np.cos(turn), np.sin(turn), np.sin(turn)])
        rotation = rotation_towards(normal, hint)
        centres = in_frame @ rotation.T + skin + STANDOFF_MM * normal
        if all(_outside(head, centre) for centre in centres):
            return tuple(
                Fiducial(number=k + 1, centre_ct_mm=_three(centre), post_ct=_three(normal))
                for k, centre in enumerate(centres)
            )
    raise BadScene("the x-shaped frame is not clear of the head")


def frame_markers(head: Head, generator: np.random.Generator) -> tuple[Marker, ...]:
    """The frame's spheres on short posts that end in the bars; any others on screws of their own."""
    flange_mm = BAR_BELOW_MM - BAR_RADIUS_MM - FLANGE_MM
    on_frame = [marker_on_foot(one, flange_mm, BAR_BELOW_MM, generator) for one in head.fiducials[:SPHERES]]
    return (*on_frame, *(marker_on_post(one, head, generator) for one in head.fiducials[SPHERES:]))


def frame_shapes(head: Head, frame: str, generator: np.random.Generator) -> tuple[Shape, ...]:
    """Bars and foot."""
    first_x, third_x = FRAMES[frame][0][0], FRAMES[frame][2][0]
    hu = float(generator.choice(BAR_HU))
    down = _three(-np.array(head.fiducials[0].post_ct))
    ends = [np.array(shifted(one.centre_ct_mm, down, BAR_BELOW_MM)) for one in head.fiducials[:SPHERES]]
    bars: list[Shape] = []
    for first, second in BARS:
        length = float(np.linalg.norm(ends[second] - ends[first]))
        along = _three((ends[second] - ends[first]) / length)
        bars.append(Rod(hu, _three(ends[first]), along, length, BAR_RADIUS_MM))
    crossing = ends[0] + first_x / (first_x - third_x) * (ends[2] - ends[0])
    depth = STANDOFF_MM - BAR_BELOW_MM + FOOT_IN_SKULL_MM
    return (*bars, Rod(FOOT_HU, _three(crossing), down, depth, FOOT_RADIUS_MM))


def _outside(head: Head, centre: Vector) -> bool:
    axes = np.array(head.semi_axes_mm) + BAR_BELOW_MM + BAR_RADIUS_MM
    return bool(np.linalg.norm((centre - head.centre_ct_mm) / axes) > 1.0)


def _three(vector: Vector) -> Point:
    x, y, z = (float(value) for value in vector)
    return x, y, z
