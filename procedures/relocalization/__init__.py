"""Fine re-localization of spheres with the stereo head: image, triangulation, visual servo. Pure numerics."""

from procedures.relocalization.pairing import AreaImage, Sighting, locate_sphere
from procedures.relocalization.search import search_offsets_mm, search_pose
from procedures.relocalization.servo import ServoSettings, ServoState, recorded_point
from procedures.relocalization.sphere import measure_sphere, measure_spheres
from procedures.relocalization.sphere_image import SphereImage, SphereStatus
from procedures.relocalization.triangulation import StereoPoint, triangulate

__all__ = [
    "AreaImage",
    "ServoSettings",
    "ServoState",
    "Sighting",
    "SphereImage",
    "SphereStatus",
    "StereoPoint",
    "locate_sphere",
    "measure_sphere",
    "measure_spheres",
    "recorded_point",
    "search_offsets_mm",
    "search_pose",
    "triangulate",
]
