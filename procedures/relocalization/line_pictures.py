"""Pairs of pictures of the laser line in a folder, and the record of plane and width that they give.

`NAME-left.png` and `NAME-right.png` show the line on the whole sensor; `NAME-left-dark.png` and
`NAME-right-dark.png`, if present, the same view without it.
"""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import cv2
import numpy as np

from procedures.relocalization.errors import NO_LINE_PICTURES
from procedures.relocalization.grey_image import AreaImage
from procedures.relocalization.laser_line import LineImage, measure_line
from procedures.relocalization.light_plane import LineRecord, record_line
from procedures.relocalization.line_points import LinePoints, triangulate_line
from procedures.relocalization.triangulation import camera_model
from ronna_hw.arrays import Array
from ronna_hw.calibration import StereoHeadCalibration

LEFT, RIGHT, DARK = "-left", "-right", "-dark"
SUFFIX = ".png"


def record_pictures(folder: Path, head: StereoHeadCalibration, now: datetime) -> LineRecord:
    """Measure the pairs of pictures in a folder, and fit plane and width of the line, seen by this head.

    Raises STE-019 without pictures, and the errors of `measure_line` and `triangulate_line`.
    """
    lefts = sorted(folder.glob(f"*{LEFT}{SUFFIX}"))
    if not lefts:
        raise NO_LINE_PICTURES(
            "there are no pictures of the line", expected=f"NAME{LEFT}{SUFFIX}", got=str(folder)
        )
    lines: list[Array] = []
    widths: list[float] = []
    for left in lefts:
        right = left.with_name(left.name.replace(LEFT, RIGHT))
        images = [_measure(file) for file in (left, right)]
        found = triangulate_line(images[0], images[1], head)
        lines.append(found.points_mm)
        widths.append(width_mm(images[0], found, head))
    seen_by = {"stereo_head": head.identifier, "camera_serials": (head.left.serial, head.right.serial)}
    return record_line(lines, widths).model_copy(update={"created": now.replace(microsecond=0), **seen_by})


def width_mm(left: LineImage, found: LinePoints, head: StereoHeadCalibration) -> float:
    """Return the width of the line across the left camera's view, one standard deviation."""
    camera = camera_model(head.left)
    distance_mm = float(np.median(np.linalg.norm(found.points_mm - camera.centre_mm, axis=1)))
    return float(np.median(left.width_px)) * distance_mm / float(np.sqrt(np.prod(head.left.focal_px)))


def _measure(file: Path) -> LineImage:
    dark = file.with_name(f"{file.stem}{DARK}{SUFFIX}")
    return measure_line(_read(file), _read(dark) if dark.exists() else None)


def _read(file: Path) -> AreaImage:
    pixels = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) if file.is_file() else None
    if pixels is None:
        raise NO_LINE_PICTURES("a picture of the line cannot be read", got=str(file))
    return AreaImage(pixels)  # `measure_line` refuses what is no grey image
