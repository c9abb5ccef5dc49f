"""Bounds of a planned trajectory, in a plan and in a scene.

The plan of a simulated patient is made from its scene: with one set of bounds, no scene is accepted whose
plan would be refused.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

# Files and records are named after a trajectory: no path, no line break, nothing that a shell reads.
NAME_PATTERN = r"^[A-Za-z0-9][A-Za-z0-9_.-]*$"
LONGEST_NAME = 32
LEAST_DEPTH_MM = 1.0  # entry and target closer than this are the same point to every instrument here
MOST_DEPTH_MM = 150.0  # from one side of a head to far beyond its middle; anything longer is a typing error
LARGEST_MARGIN_MM = 20.0  # accepted error at a target
LARGEST_ANGLE_DEG = 360.0  # about the axis, either way

TrajectoryName = Annotated[str, Field(min_length=1, max_length=LONGEST_NAME, pattern=NAME_PATTERN)]
FreeAngle = Annotated[float, Field(allow_inf_nan=False, ge=-LARGEST_ANGLE_DEG, le=LARGEST_ANGLE_DEG)]
Margin = Annotated[float, Field(allow_inf_nan=False, gt=0.0, le=LARGEST_MARGIN_MM)]
