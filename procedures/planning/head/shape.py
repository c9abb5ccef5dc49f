"""The head as one ellipsoid, from its CT: an obstacle for the arm.

Everything denser than air and thick enough is included. Thin objects (posts and cables, the shell of a
headrest, the tips of ears) are removed first, so that they do not inflate the ellipsoid.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from procedures.planning.errors import NoHeadInCt
from ronna_hw.calibration import Numbers3, Strict

if TYPE_CHECKING:
    from procedures.imaging.volume import Volume

Array = NDArray[np.float64]

AIR_BELOW_HU = -300.0  # fat is about -100, foam of a headrest about -930, air -1000
GRID_MM = 4.0  # a head is large: this resolution is enough
THIN_MM = 18.0  # anything thinner in any direction is not part of the head
LEAST_VOXELS = 500  # 32 ml: anything smaller is not a head


class HeadEllipsoid(Strict):
    """The head as one ellipsoid, in CT coordinates."""

    centre_mm: Numbers3 = Field(description="Its centre, LPS.")
    semi_axes_mm: Numbers3 = Field(description="Semi-axes along left, posterior, superior.")

    def side_of(self, entry_mm: Numbers3, target_mm: Numbers3) -> str:
        """The patient's side of a trajectory in this head: `right`, or `left to right` if it crosses over."""
        return " to ".join(dict.fromkeys(self._side(x) for x, *_ in (entry_mm, target_mm)))

    def _side(self, x_mm: float) -> str:
        beyond_mm = x_mm - self.centre_mm[0]
        if abs(beyond_mm) < GRID_MM:  # the head's middle is not known better
            return "middle"
        return "left" if beyond_mm > 0.0 else "right"


def head_shape(volume: Volume) -> HeadEllipsoid:
    """The smallest ellipsoid along the CT's axes that contains the whole head. Raises PLAN-014.

    A head cut off by the CT is used as far as the CT shows it.
    """
    from scipy import ndimage

    strides = np.maximum(1, np.rint(GRID_MM / volume.geometry.spacing_mm)).astype(int)
    thinned = volume.voxels[tuple(slice(None, None, int(stride)) for stride in strides)]
    spacing_mm = volume.geometry.spacing_mm * strides
    solid = thinned > AIR_BELOW_HU
    rounds = max(1, round(THIN_MM / 2.0 / float(spacing_mm.mean())))
    # Filled first: air in sinuses and throat must not hollow it out.
    solid = ndimage.binary_fill_holes(solid)
    # The border counts as solid, so that a head cut off by the CT keeps its cut face.
    kept = ndimage.binary_erosion(solid, iterations=rounds, border_value=1)
    labels, count = ndimage.label(kept)
    sizes = np.bincount(labels.ravel())[1:] if count else np.zeros(1, dtype=int)
    if sizes.max() < LEAST_VOXELS:
        raise NoHeadInCt("the CT shows nothing of the size of a head", got=f"{sizes.max()} solid cells")
    largest = labels == 1 + int(sizes.argmax())
    largest = ndimage.binary_dilation(largest, iterations=rounds)
    points = volume.geometry.to_patient_mm(np.argwhere(largest) * strides)
    centre, semi = least_ellipsoid(points)
    # plus the grid step, and what opening rounds off
    return HeadEllipsoid(centre_mm=_three(centre), semi_axes_mm=_three(semi + float(spacing_mm.max())))


def least_ellipsoid(points_mm: Array) -> tuple[Array, Array]:
    """Centre and semi-axes, (3,) each, of the smallest axis-aligned ellipsoid around points (n, 3).

    Convex in reciprocal axes and scaled centre: min -sum(log b) under |b p - d| <= 1 (Boyd & Vandenberghe,
    Convex Optimization, 8.4.1). Not simply the bounding box: half a head is not a small whole one.
    """
    from scipy.optimize import minimize
    from scipy.spatial import ConvexHull

    low, high = points_mm.min(axis=0), points_mm.max(axis=0)
    middle, half = (low + high) / 2.0, (high - low) / 2.0
    unit = (points_mm[ConvexHull(points_mm).vertices] - middle) / half  # each between -1 and 1

    def room(unknown: Array) -> Array:
        return np.asarray(1.0 - ((unknown[:3] * unit - unknown[3:]) ** 2).sum(axis=1))

    def slope(unknown: Array) -> Array:
        beside = unknown[:3] * unit - unknown[3:]
        return np.hstack([-2.0 * beside * unit, 2.0 * beside])

    found = minimize(
        lambda unknown: -np.log(unknown[:3]).sum(),
        np.r_[np.full(3, 1.0 / np.sqrt(3.0)), np.zeros(3)],  # the circumscribed ball contains them all
        jac=lambda unknown: np.r_[-1.0 / unknown[:3], np.zeros(3)],
        constraints={"type": "ineq", "fun": room, "jac": slope},
        bounds=[(0.1, 2.0)] * 3 + [(None, None)] * 3,
        method="SLSQP",
    )
    semi, centre = 1.0 / found.x[:3], found.x[3:] / found.x[:3]
    # exactly around all points, whatever error the search left
    beyond = float(np.linalg.norm((unit - centre) / semi, axis=1).max())
    return middle + half * centre, half * semi * beyond


def _three(values: Any) -> Numbers3:
    x, y, z = (float(value) for value in values)
    return (x, y, z)
