"""Deformation common to all spheres of a scan: tested against zero, and what the test leaves open.

Every sphere is a ball. Wrong table feed, pixel size or axes between pixels, and an unstated tilt stretch or
shear all of them alike. The mean of their shapes, weighted by covariance, is tested by chi-square. One sphere
may be odd for reasons of its own: spheres that disagree widen the covariance (Birge 1932).

A common scale shows in no shape, since a film and the level of the edge move a radius by more. For it, and
within what the shapes resolve, the usual errors of a scanner count (Bayes). Nothing is corrected, so
the mean of what is left counts like its spread.
"""

from __future__ import annotations

from collections.abc import Sequence
from math import pi, sqrt

import numpy as np
from scipy.special import chdtri

from procedures.imaging.errors import ScanDeformed
from procedures.imaging.markers import ScanDeformation
from procedures.imaging.sphere_centre.ball_model import TERMS, Stretch, stretch_matrix
from procedures.imaging.volume import VoxelGeometry
from ronna_hw.arrays import Array
from ronna_hw.text import format_distinct

# Standard deviations of the deviation from a ball beyond the covariance of its fit, per unit of length, from
# phantoms of all protocols, kernels and slices. `FIT`: of one sphere, from hardening and streaks.
FIT = 2e-4
# The next two stretch all spheres of a scan alike, along the slices. `PROFILE`, times the fifth power of the
# blur in mm: slices are boxes, the model's are Gaussian; blurs of 0.45, 0.68 and 0.93 mm leave 0.01, 0.08 and
# 0.5 %. `KERNEL`: a sharp one, which enhances edges within the slices alone, leaves 0.04 %.
PROFILE_PER_MM5 = 6.9e-3
KERNEL = 2.5e-4

FALSE_ALARMS = 1e-3  # one undistorted scan in a thousand is refused
WIDENED_BEYOND = 0.95

# Usual errors of a scanner, one standard deviation: half the tolerances of AAPM TG-66 (Mutic et al. 2003), of
# 1 mm over 300 mm of table, 1 mm over 250 mm within the slice, and 1 degree of tilt (unconfirmed).
TABLE_FEED = 0.5 * 1.0 / 300.0
PIXEL_SIZE = 0.5 * 1.0 / 250.0
TILT_RAD = 0.5 * pi / 180.0

# covariance of the terms of a stretch that is as likely along any direction, 1 along each axis
ALIKE = np.diag([1.5, 1.5, 3.0, 3.0, 3.0])
ALIKE[:2, :2] -= 0.5

SYMMETRIC = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]  # rows and columns of LL, PP, SS, LP, LS, PS
TRACELESS = [0, 1, 3, 4, 5]  # of these, that tell the rest
SCANNER_ERRORS = np.array(  # a row for each: its components, with the table along S
    [
        [PIXEL_SIZE, PIXEL_SIZE, 0.0, 0.0, 0.0, 0.0],
        [0.5 * PIXEL_SIZE, -0.5 * PIXEL_SIZE, 0.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.5 * PIXEL_SIZE, 0.0, 0.0],
        [0.0, 0.0, TABLE_FEED, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.5 * TILT_RAD, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, 0.5 * TILT_RAD],
    ]
)


def require_undeformed(found: ScanDeformation | None) -> None:
    """Raise CT-024 if the spheres of a scan show a significant strain."""
    if found is None or found.chi_square <= found.limit:
        return
    stretches, axes = np.linalg.eigh(np.array(found.strain))
    percent = 100.0 * float(np.ptp(stretches))
    size, limit = format_distinct(percent, percent * sqrt(found.limit / found.chi_square), 2)
    longest, shortest = (_word_direction(axes[:, axis]) for axis in (-1, 0))
    raise ScanDeformed(
        f"by the shape of {found.spheres} spheres the scan is longer along {longest} than along {shortest}, "
        f"by {size} %",
        limit=f"{limit} %",
    )


def _word_direction(direction: Array) -> str:
    """Write a direction in L, P, S, with its largest component positive."""
    signed = direction * np.sign(direction[np.abs(direction).argmax()])
    return f"({', '.join(f'{value:z.2f}' for value in signed)})"


def combine_spheres(
    stretches: Sequence[Stretch | None], radius_mm: float, geometry: VoxelGeometry
) -> ScanDeformation | None:
    """Combine the shapes of all spheres; return None if none has been measured."""
    measured = [one for one in stretches if one is not None]
    if not measured:
        return None
    units = [geometry.covariance_to_patient(stretch_matrix(one)) for one in np.eye(TERMS)]
    turned = np.array([one[SYMMETRIC][TRACELESS] for one in units]).T  # terms to LL, PP, LP, LS and PS
    found = np.array([one.coefficients_mm for one in measured]) / radius_mm
    weights = np.linalg.inv(
        np.array([one.covariance_mm2 for one in measured]) / radius_mm**2 + FIT**2 * ALIKE
    )
    covariance = np.linalg.inv(weights.sum(axis=0))
    mean = covariance @ np.einsum("nij,nj->i", weights, found)
    apart = found - mean
    freedom = TERMS * (len(measured) - 1)
    disagreement = float(np.einsum("ni,nij,nj->", apart, weights, apart))
    if freedom and disagreement > chdtri(freedom, 1.0 - WIDENED_BEYOND):
        covariance = covariance * disagreement / freedom
    blur_mm = max(one.slice_blur_mm for one in measured)
    along = np.hypot(PROFILE_PER_MM5 * blur_mm**5, KERNEL) * np.array([1.0, -0.5, 0.0, 0.0, 0.0])
    covariance = covariance + np.outer(along, along)
    strain = geometry.covariance_to_patient(stretch_matrix(mean))
    turned_covariance = turned @ covariance @ turned.T
    return ScanDeformation(
        spheres=len(measured),
        strain=strain.tolist(),
        covariance=(0.5 * (turned_covariance + turned_covariance.T)).tolist(),
        chi_square=float(mean @ np.linalg.solve(covariance, mean)),
        limit=float(chdtri(TERMS, FALSE_ALARMS)),
    )


def open_strains(measured: ScanDeformation | None) -> Array:
    """Return six strains (6, 3, 3), LPS, of one standard deviation each: what a scan may still be off by.

    They combine the usual errors of a scanner with what the spheres have shown.
    """
    errors = SCANNER_ERRORS.T
    covariance = errors @ errors.T
    if measured is not None:
        shown = np.eye(6)
        shown[:3, :3] -= 1.0 / 3.0  # a scale shows in no shape
        shown = shown[TRACELESS]
        gain = np.linalg.solve(
            shown @ covariance @ shown.T + np.array(measured.covariance), shown @ covariance
        ).T
        mean = gain @ np.array(measured.strain)[SYMMETRIC][TRACELESS]
        covariance = covariance - gain @ shown @ covariance + np.outer(mean, mean)
    values, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T))
    components = (vectors * np.sqrt(np.maximum(values, 0.0))).T
    strains = np.empty((len(components), 3, 3))
    for rows, columns in (SYMMETRIC, SYMMETRIC[::-1]):
        strains[:, rows, columns] = components
    return strains
