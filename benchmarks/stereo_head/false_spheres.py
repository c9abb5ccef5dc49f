"""Deceptive images: glare, a blot of blood, a second sphere, a sphere half out of the image.

A returned point must be the centre of a sphere. None is better than a wrong one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.stereo_head.stereo_pictures import Case, Pair, Studio
from procedures.relocalization import AreaImage, locate_sphere
from procedures.relocalization.errors import NoContrast, NoSphere, RaysDoNotMeet, WrongSize

WHOLE_PX = (2048, 1088)
GLARE = Case("glare of 20 to 320 px radius", reach_mm=2.0, glare_px=(20.0, 320.0), area_px=WHOLE_PX)
BLOT = Case("blot of up to half the sphere", reach_mm=2.0, blot_rad=(0.2, 0.8), area_px=WHOLE_PX)
SECOND = Case("second sphere", reach_mm=2.0, second_mm=(12.0, 22.0), area_px=WHOLE_PX)
HALF_VIEW = Case("up to 20 mm off: half or all out of view", reach_mm=20.0, area_px=WHOLE_PX)
SPHERE_SIZED_GLARE = Case(
    "glare of the sphere's size", reach_mm=2.0, glare_px=(240.0, 285.0), area_px=WHOLE_PX
)
DECEIVING = (GLARE, BLOT, SECOND, HALF_VIEW)
RIGHT_MM = 0.01  # goal 16: allowed error from a stained and partly hidden sphere
NOTHING_SEEN = (NoContrast, NoSphere, RaysDoNotMeet, WrongSize)


@dataclass
class Verdicts:
    """Pairs by result: the sphere's centre, the second one's, another point, or none."""

    right: int = 0
    second: int = 0
    wrong: int = 0
    none: int = 0

    @property
    def pairs(self) -> int:
        """Total number."""
        return self.right + self.second + self.wrong + self.none


def deceive(studio: Studio, case: Case, count: int, *, seed: int = 9) -> Verdicts:
    """Locate the sphere in `count` pairs of a case."""
    calibration = studio.calibration()
    verdicts = Verdicts()
    for pair in studio.pairs(case, count, seed):
        left, right = (AreaImage(view.picture, *view.offset_px) for view in pair.views)
        try:
            point = locate_sphere(left, right, calibration).point
        except NOTHING_SEEN:
            point = None
        if point is None:
            verdicts.none += 1
        else:
            _judge(point.position_mm, pair, verdicts)
    return verdicts


def _judge(point_mm: np.ndarray, pair: Pair, verdicts: Verdicts) -> None:
    if np.linalg.norm(point_mm - pair.centre_mm) <= RIGHT_MM:
        verdicts.right += 1
    elif pair.second_mm is not None and np.linalg.norm(point_mm - pair.second_mm) <= RIGHT_MM:
        verdicts.second += 1
    else:
        verdicts.wrong += 1
