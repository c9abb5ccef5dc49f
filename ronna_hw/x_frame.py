"""The x-shaped frames: four spheres at the ends of two crossed bars, screwed to the skull as one piece.

Ours is the template that gives four fiducials distances of their own: each of the six differs by more than
8 mm from every other, and by more than 5 mm from every distance of the robot's reference frame M, so that
neither can be taken for the other. The CT, the tracker and the phantom all mean this one frame. The close one
is for studies beside the thesis only: the six distances of its frame differed by little more than 4.5 mm.

Frame x: the origin is where the bars cross, the first bar lies along x, z points away from the skull.
"""

from __future__ import annotations

from typing import Final

Point = tuple[float, float, float]

SPHERE_CENTRES_MM: Final[tuple[Point, Point, Point, Point]] = (
    (35.0, 0.0, 0.0),
    (31.5, 50.0, 0.0),
    (-61.0, 0.0, 0.0),
    (-32.5, -51.5, 0.0),
)
CLOSE_SPHERE_CENTRES_MM: Final[tuple[Point, Point, Point, Point]] = (
    (38.0, 0.0, 0.0),
    (12.0, 47.5, 0.0),
    (-30.0, 0.0, 0.0),
    (-14.0, -56.5, 0.0),
)
OUTWARD: Final[Point] = (0.0, 0.0, 1.0)  # all spheres are seen from this side
