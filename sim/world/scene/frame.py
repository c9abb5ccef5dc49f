"""The x-shaped frame on a generated head: screwed to the skull by one foot, next to the entry points.

It stays on from the CT to the end of the operation; its spheres are removed and reattached like any others.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, radians, sin
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ronna_hw.x_frame import BAR_BELOW_MM, BAR_RADIUS_MM, SPHERE_CENTRES_MM, STANDOFF_MM, bodies
from sim.errors import BadScene
from sim.world.rigid import rotation_towards
from sim.world.scene.model import Fiducial
from sim.world.scene.skin import CAP_AXIS_CT, CENTRE_CT_MM, SEMI_AXES_MM, skin_at

Vector = NDArray[np.float64]

# From the middle of the cap towards the patient's left, on the tracker's side: it sees a tool up to 60
# degrees off its normal.
TILT_RAD = (radians(15.0), radians(25.0))
SIDE_RAD = radians(35.0)  # to either side of straight left
LEFT_CT = (1.0, 0.0, 0.0)
HEAD_CLEARANCE_MM = 2.0  # of the bars
GUIDE_CLEARANCE_MM = 26.0  # from the axis of a trajectory to sphere and bar
GUIDE_MM, SAMPLE_MM = 90.0, 3.0  # outside the skin, along the trajectory; along bars
ATTEMPTS = 2000


@dataclass(frozen=True)
class FrameOnHead:
    """Its spheres, and points (n, 3) along its bars and foot, CT frame."""

    fiducials: tuple[Fiducial, ...]
    body_mm: Vector

    def leaves_free(self, entry_mm: Vector, outwards: Vector) -> bool:
        """Whether a guide over an entry (3,), along the unit vector, is clear of it."""
        away = self.body_mm - entry_mm
        along = np.clip(away @ outwards, 0.0, GUIDE_MM)
        aside = np.linalg.norm(away - along[:, None] * outwards, axis=1)
        return bool(aside.min() >= GUIDE_CLEARANCE_MM)


def draw_frame(generator: np.random.Generator) -> FrameOnHead:
    """Place the frame on the head; raises SIM-001 if it is not clear of it."""
    axis = np.array(CAP_AXIS_CT) / np.linalg.norm(CAP_AXIS_CT)
    left = np.array(LEFT_CT)
    front = np.cross(axis, left)
    for _ in range(ATTEMPTS):
        tilt, side = generator.uniform(*TILT_RAD), generator.uniform(-SIDE_RAD, SIDE_RAD)
        direction = cos(tilt) * axis + sin(tilt) * (cos(side) * left + sin(side) * front)
        skin, normal = skin_at(direction)
        turn = generator.uniform(0.0, 2.0 * np.pi)
        across = np.cross(normal, front)
        rotation = rotation_towards(normal, cos(turn) * front + sin(turn) * across)
        origin = skin + CENTRE_CT_MM + STANDOFF_MM * normal
        bars, foot = bodies()[:-1], bodies()[-1]
        on_bars = np.vstack([_along(one.start_mm, one.end_mm) for one in bars]) @ rotation.T + origin
        if not _clear(on_bars):
            continue
        centres = np.array(SPHERE_CENTRES_MM) @ rotation.T + origin
        on_foot = _along(foot.start_mm, foot.end_mm) @ rotation.T + origin
        return FrameOnHead(
            tuple(
                Fiducial(
                    number=number, centre_ct_mm=_three(centre), post_ct=_three(normal), base_mm=BAR_BELOW_MM
                )
                for number, centre in enumerate(centres, start=1)
            ),
            np.vstack([centres, on_bars, on_foot]),
        )
    raise BadScene("the x-shaped frame is not clear of the head")


def _clear(points_mm: Vector) -> bool:
    axes = np.array(SEMI_AXES_MM) + BAR_RADIUS_MM + HEAD_CLEARANCE_MM
    return bool((np.linalg.norm((points_mm - CENTRE_CT_MM) / axes, axis=1) > 1.0).all())


def _along(start: tuple[float, ...], end: tuple[float, ...]) -> Vector:
    length = float(np.linalg.norm(np.subtract(end, start)))
    return np.linspace(start, end, 2 + round(length / SAMPLE_MM))


def _three(vector: Vector) -> Any:
    return tuple(round(float(value), 6) for value in vector)
