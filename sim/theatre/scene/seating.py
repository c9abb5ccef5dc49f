"""Where the spheres stand in the theatre.

Their screws stay, bases and spheres come off after the CT and are put back: each then stands a little beside
its place in the CT. The cameras and the tracker see the spheres of the theatre, the scanner those of the CT.
"""

from __future__ import annotations

import numpy as np

from sim.theatre.noise import noise
from sim.theatre.scene.model import Fiducial, Scene

SEATING = "seating"  # of the noise: each sphere has its own, whatever the others are


def spheres_in_theatre(scene: Scene) -> tuple[Fiducial, ...]:
    """The spheres as they stand in the theatre, in the order of the scene; CT frame, mm."""
    return tuple(_seated(one, scene) for one in scene.head.fiducials)


def _seated(sphere: Fiducial, scene: Scene) -> Fiducial:
    beside_mm = noise(scene.seed, SEATING, sphere.number).normal(0.0, scene.head.seating_error_mm, 3)
    x, y, z = (np.array(sphere.centre_ct_mm) + beside_mm).tolist()
    return sphere.model_copy(update={"centre_ct_mm": (x, y, z)})
