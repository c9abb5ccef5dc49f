"""The in-process stereo cell and the campaigns of `benchmarks`, which is not an installed package."""

from __future__ import annotations

import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.append(str(ROOT))

from benchmarks.false_spheres import DECEIVING, SPHERE_SIZED_GLARE, deceive  # noqa: E402
from benchmarks.servo_campaign import calibrated_cell, servo_campaign  # noqa: E402
from benchmarks.sphere_campaign import (  # noqa: E402
    CENTRED,
    DEFOCUSED,
    HALF_HIDDEN,
    HONEST,
    JUST_HIDDEN,
    OCCLUDED,
    OFF_AXIS,
    campaign,
)
from benchmarks.stereo_cell import StereoCell, without_arm_errors  # noqa: E402
from benchmarks.stereo_pictures import Case, Studio  # noqa: E402

__all__ = [
    "CENTRED",
    "DECEIVING",
    "DEFOCUSED",
    "HALF_HIDDEN",
    "HONEST",
    "JUST_HIDDEN",
    "OCCLUDED",
    "OFF_AXIS",
    "SPHERE_SIZED_GLARE",
    "Case",
    "StereoCell",
    "Studio",
    "calibrated_cell",
    "campaign",
    "deceive",
    "servo_campaign",
    "without_arm_errors",
]
