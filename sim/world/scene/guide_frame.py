"""A frame of spheres on the guide, by which the tracker identifies the mounted guide and its pose."""

from __future__ import annotations

from ronna_hw.calibration import PoseRecord

NAME = "guide_frame"
PART_NUMBER = "RONNA-G"
# Six distances that differ by more than 5 mm among themselves and by more than 2 mm from other frames'.
MARKERS_MM = ((-49.0, -40.0, 0.0), (-18.0, -6.0, 0.0), (-34.0, 31.0, 0.0), (32.0, 18.0, 0.0))
# Above the upper end of the bore, beside the mount; it faces up, as M does.
IN_TIP = PoseRecord(translation_mm=(-90.0, 0.0, -215.0), quaternion_wxyz=(0.0, 1.0, 0.0, 0.0))
