"""Patient's reference frame: four spheres on a plate on the head clamp, a rigid body of their own.

The tracker follows it all the time beside the frame M on the arm. It moves with the clamped head and stays in
view where drapes, the guide or the arm hide the spheres on the skull. Each of its six distances differs by
more than 6 mm from every other and by more than 2.5 mm from every distance of the frames on the arm, on the
guide and on the skull, so that no triangle of it is mistaken for one of theirs.
"""

from __future__ import annotations

from typing import Final

Point = tuple[float, float, float]

MARKERS_MM: Final[tuple[Point, Point, Point, Point]] = (
    (-63.0, 40.0, 0.0),
    (-11.0, 73.0, 0.0),
    (63.0, 17.0, 0.0),
    (-11.0, -62.0, 0.0),
)
NAME: Final = "patient_frame"  # as a tool of the tracker
PART_NUMBER: Final = "RONNA-P"  # of its definition
