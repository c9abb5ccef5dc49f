"""X-shaped frame: four spheres at the ends of two crossed bars, screwed to the skull as one piece.

Ours is a template that gives four fiducials unique distances: each of the six differs by more than 8 mm from
every other, and by more than 5 mm from every distance of the robot's reference frame M, so that neither can
be mistaken for the other. The CT, the tracker and the phantom all use this one frame. The close one is only
for studies next to the thesis: the six distances of its frame differed by little more than 4.5 mm.

Frame x: the origin is where the bars cross, the first bar is along x, z points away from the skull.
"""

from __future__ import annotations

from typing import Final, NamedTuple

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
# The spheres are on short posts on the bars; a foot under the crossing is screwed to the skull.
BAR_BELOW_MM: Final = 11.0  # axis of the bars under the spheres' centres
BAR_RADIUS_MM: Final = 3.5
FOOT_RADIUS_MM: Final = 3.0
STANDOFF_MM: Final = 26.0  # from the skin to the plane of the spheres, at the foot
BARS: Final = ((0, 2), (1, 3))  # the spheres at their ends
NAME: Final = "x_frame"  # as a tool of the tracker
PART_NUMBER: Final = "RONNA-X"  # of its definition
OUTWARD: Final[Point] = (0.0, 0.0, 1.0)  # all spheres are visible from this side


class FrameRod(NamedTuple):
    """Rod of the frame, in mm and in the frame's own coordinates."""

    name: str
    start_mm: Point
    end_mm: Point
    radius_mm: float


def bodies() -> tuple[FrameRod, ...]:
    """Return the two bars and the foot, the latter down to the skin."""
    ends = ((_bar_end(first), _bar_end(second)) for first, second in BARS)
    bars = (FrameRod(f"bar {k} of the frame", *pair, BAR_RADIUS_MM) for k, pair in enumerate(ends, start=1))
    foot = FrameRod("foot of the frame", (0.0, 0.0, -BAR_BELOW_MM), (0.0, 0.0, -STANDOFF_MM), FOOT_RADIUS_MM)
    return (*bars, foot)


def _bar_end(sphere: int) -> Point:
    x, y, z = SPHERE_CENTRES_MM[sphere]
    return (x, y, z - BAR_BELOW_MM)
