"""Bars and foot of the x-shaped frame, located by its spheres in the CT: obstacles for the arm."""

from __future__ import annotations

from numpy.typing import ArrayLike

from procedures.planning.plan.model import FiducialKind
from procedures.registration.template import find_layout
from ronna_hw.arm.clearance.bodies import Capsule, Obstacle
from ronna_hw.x_frame import SPHERE_CENTRES_MM, bodies

COARSE_MM = 1.25  # around them: error of the coarse localization


def frame_bodies(fiducials: FiducialKind, spheres_ct_mm: ArrayLike) -> tuple[Obstacle, ...]:
    """Its rods in the CT frame; none for free spheres. Raises REG-012 if it is not among the spheres."""
    if fiducials is not FiducialKind.XFRAME:
        return ()
    place = find_layout(SPHERE_CENTRES_MM, spheres_ct_mm).scan_from_layout
    found = []
    for one in bodies():
        (ax, ay, az), (bx, by, bz) = place.apply([one.start_mm, one.end_mm]).tolist()
        found.append(Obstacle(one.name, Capsule((ax, ay, az), (bx, by, bz), one.radius_mm + COARSE_MM)))
    return tuple(found)
