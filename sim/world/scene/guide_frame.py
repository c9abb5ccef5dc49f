"""A frame of spheres on the guide, by which the tracker identifies the mounted guide and its pose."""

from __future__ import annotations

NAME = "guide_frame"
PART_NUMBER = "RONNA-G"
# Six distances that differ by more than 5 mm among themselves and by more than 2 mm from other frames'.
MARKERS_MM = ((-49.0, -40.0, 0.0), (-18.0, -6.0, 0.0), (-34.0, 31.0, 0.0), (32.0, 18.0, 0.0))
