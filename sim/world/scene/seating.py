"""Positions of the spheres in the theatre.

Their screws stay, bases and spheres are removed after the CT and reattached: each is then slightly off its
position in the CT. One may also be on a loosened screw or a bent base, on the base of another, or missing.
Cameras and tracker see the spheres of the theatre, the scanner those of the CT.
"""

from __future__ import annotations

import numpy as np

from sim.world.noise import noise
from sim.world.scene.model import Fiducial, Scene

SEATING = "seating"  # of the noise: each screw has its own, independent of the others


def spheres_in_theatre(scene: Scene) -> tuple[Fiducial, ...]:
    """Sphere positions in the theatre, in the order of the scene; CT frame, mm."""
    return tuple(_put_back(one, scene) for one in scene.head.fiducials if not one.missing)


def _put_back(sphere: Fiducial, scene: Scene) -> Fiducial:
    """The sphere on its screw in its present state."""
    place_mm = np.array(sphere.centre_ct_mm) + sphere.displaced_mm
    place_mm += noise(scene.seed, SEATING, sphere.number).normal(0.0, scene.head.seating_error_mm, 3)
    wanted = sphere.base_in_theatre or sphere.number
    base = next(one for one in scene.head.fiducials if one.number == wanted)
    place_mm += (base.base_mm - sphere.base_mm) * np.array(sphere.post_ct)
    x, y, z = place_mm.tolist()
    worn = {"radius_mm": base.radius_mm, "worn_percent": base.worn_percent}
    return sphere.model_copy(update={"centre_ct_mm": (x, y, z), **worn})
