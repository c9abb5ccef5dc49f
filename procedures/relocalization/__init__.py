"""Numerics of the stereo head: spheres and laser lines in images, triangulation, servoing."""

from procedures.relocalization.grey_image import AreaImage
from procedures.relocalization.laser_line import LineImage, measure_line
from procedures.relocalization.line_points import LinePoints, triangulate_line
from procedures.relocalization.outline import SphereImage, SphereStatus
from procedures.relocalization.servo import (
    ServoSettings,
    ServoState,
    recorded_point,
    search_offsets_mm,
    search_pose,
)
from procedures.relocalization.sphere_measurement import (
    SphereSighting,
    locate_sphere,
    measure_sphere,
    measure_spheres,
)
from procedures.relocalization.triangulation import StereoPoint, triangulate

__all__ = [
    "AreaImage",
    "LineImage",
    "LinePoints",
    "ServoSettings",
    "ServoState",
    "SphereImage",
    "SphereSighting",
    "SphereStatus",
    "StereoPoint",
    "locate_sphere",
    "measure_line",
    "measure_sphere",
    "measure_spheres",
    "recorded_point",
    "search_offsets_mm",
    "search_pose",
    "triangulate",
    "triangulate_line",
]


def __dir__() -> list[str]:
    return list(__all__)
