"""Fine re-localization of spheres with the stereo head: image, triangulation, visual servo. Pure numerics."""

from procedures.relocalization.search import search_offsets_mm, search_pose
from procedures.relocalization.servo import ServoSettings, ServoState, recorded_point
from procedures.relocalization.sphere import SphereImage, SphereStatus, measure_sphere
from procedures.relocalization.triangulation import StereoPoint, triangulate

__all__ = [
    "ServoSettings",
    "ServoState",
    "SphereImage",
    "SphereStatus",
    "StereoPoint",
    "measure_sphere",
    "recorded_point",
    "search_offsets_mm",
    "search_pose",
    "triangulate",
]
