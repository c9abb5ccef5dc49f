"""Search pattern for a sphere that is not in view: rings around the first pose, from near to far."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.errors import SphereNotInView
from ronna_hw.frames import Transform

Array = NDArray[np.float64]

RINGS = 3
RING_STEP_MM = 5.0
SEARCH_RADIUS_MM = RINGS * RING_STEP_MM
LOOKS_PER_RING = 6  # on the first; each further ring has that many more, so that looks stay about 5 mm apart


def search_offsets_mm(rings: int = RINGS, ring_step_mm: float = RING_STEP_MM) -> Array:
    """Offsets (n, 3) in the tool frame, mm, perpendicular to the tool axis, without the first pose itself.

    Each ring starts where the previous one ended, so the head moves in a spiral.
    """
    offsets = []
    first = 0.0
    for ring in range(1, rings + 1):
        looks = LOOKS_PER_RING * ring
        angles = first + np.arange(looks) * (2.0 * np.pi / looks)
        radius = ring * ring_step_mm
        offsets += [(radius * np.cos(angle), radius * np.sin(angle), 0.0) for angle in angles]
        first = float(angles[-1])
    return np.array(offsets).reshape(-1, 3)


def search_pose(
    start: Transform, look: int, rings: int = RINGS, ring_step_mm: float = RING_STEP_MM
) -> Transform:
    """Pose of look number `look` (from 0), oriented like `start`; raises STE-009 when none is left."""
    offsets = search_offsets_mm(rings, ring_step_mm)
    if look >= len(offsets):
        raise SphereNotInView(
            f"no sphere in {len(offsets)} image pairs", limit=f"{rings * ring_step_mm:g} mm around the pose"
        )
    return Transform.of(
        start.target,
        start.source,
        translation_mm=start.apply(offsets[look]),
        quaternion_wxyz=start.quaternion_wxyz,
    )
