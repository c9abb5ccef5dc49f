"""A painted scan as the localizer takes it, and its markers held against the true centres."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from procedures.imaging import Localization, Marker, Volume, VoxelGeometry
from ronna_hw.arrays import Array


def as_volume(scan: Any, origin_mm: ArrayLike = (0.0, 0.0, 0.0), axes: ArrayLike | None = None) -> Volume:
    """The scan; without axes, its grid positions are those of the patient."""
    turned = np.eye(3) if axes is None else np.asarray(axes)
    geometry = VoxelGeometry(scan.shape, np.asarray(origin_mm), turned, np.array(scan.spacing_mm))
    return Volume(scan.voxels(), geometry, "1.2.3", "1.2.4")


def matched(found: Localization, centres: Array) -> tuple[Array, Array]:
    """Errors (n, 3) and covariances (n, 3, 3) of the markers nearest to the true centres."""
    assert len(found.markers) == len(centres), [one.describe() for one in found.candidates]
    nearest = [int(np.argmin(np.linalg.norm(found.centres_mm - centre, axis=1))) for centre in centres]
    assert sorted(nearest) == list(range(len(centres)))
    return found.centres_mm[nearest] - centres, found.covariances_mm2[nearest]


def localized_marker(
    centre_mm: ArrayLike, covariance_mm2: ArrayLike, flags: tuple[str, ...] = (), agreement_mm: float = 0.0
) -> Marker:
    """A marker of the usual size and of full quality."""
    return Marker(
        centre_mm=np.asarray(centre_mm).tolist(),
        covariance_mm2=np.asarray(covariance_mm2).tolist(),
        radius_mm=5.75,
        quality=1.0,
        agreement_mm=agreement_mm,
        flags=flags,
        odds=1.0,
    )


def rms(errors_mm: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(errors_mm**2, axis=1))))
