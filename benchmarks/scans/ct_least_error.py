"""How well could any method localize a bare ball in the phantom's noise?

The Cramér-Rao bound that errors are compared with is for white noise. The phantom's noise is correlated
within a slice: this computes the bound for the same ball in it, with blur, radius and intensities also
unknown. Slopes and bends of the background, which our localizer also allows for, are left out.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import exp, sqrt

import numpy as np
from numpy.typing import NDArray
from scipy.special import erfc

from sim.phantom.head.painting import PLANE_SIGMA_MM, SLICE_SIGMA_MM

Array = NDArray[np.float64]
Spectrum = NDArray[np.complex128]

SIDE_MM = 26.0  # of the cube of air around the ball
OFFSET = np.array([0.31, -0.17, 0.08])  # of its centre from a voxel's, in voxels: arbitrary
STEP = 1e-3  # for numerical differences
BOX_VARIANCE = 1.0 / 12.0


@dataclass(frozen=True)
class BallScan:
    """A ball in air as scanned by the phantom: lengths in mm, intensities in HU."""

    pixel_mm: float
    slice_mm: float
    noise_hu: float
    contrast_hu: float
    radius_mm: float

    @property
    def spacing_mm(self) -> Array:
        """Along slices, rows, columns."""
        return np.array([self.slice_mm, self.pixel_mm, self.pixel_mm])


def least_errors_mm(scan: BallScan) -> tuple[float, float]:
    """Smallest possible 3-D rms errors: with all voxels weighted equally, and with known noise spectrum."""
    derivatives = np.array([np.fft.fftn(one).ravel() for one in _derivatives(scan)])
    derivatives /= sqrt(derivatives.shape[1])
    power = _noise_power(scan).ravel()
    errors = []
    for weights in (np.ones(len(power)), 1.0 / power):
        filtered = derivatives * weights
        answer = np.linalg.inv((filtered @ derivatives.conj().T).real)
        covariance = answer @ ((filtered * power) @ filtered.conj().T).real @ answer
        errors.append(sqrt(float(np.trace(covariance[:3, :3]))))
    return errors[0], errors[1]


def _shape(scan: BallScan) -> tuple[int, ...]:
    return tuple(int(count) for count in SIDE_MM / scan.spacing_mm)


def _derivatives(scan: BallScan) -> list[Array]:
    """Derivatives of the image by centre (slice, row, column), radius, both blurs, contrast, surroundings."""
    along = sqrt(SLICE_SIGMA_MM**2 + BOX_VARIANCE * scan.slice_mm**2)
    across = sqrt(PLANE_SIGMA_MM**2 + BOX_VARIANCE * scan.pixel_mm**2)
    start = np.array([*(OFFSET * scan.spacing_mm), scan.radius_mm, along, across])
    places = [(np.arange(n) - n // 2) * step for n, step in zip(_shape(scan), scan.spacing_mm, strict=True)]

    def image(unknowns: Array) -> Array:
        return scan.contrast_hu * _cover(places, unknowns)

    def by(number: int, view: Callable[[Array], Array]) -> Array:
        step = np.zeros(len(start))
        step[number] = STEP
        return (view(start + step) - view(start - step)) / (2.0 * STEP)

    return [
        *(by(number, image) for number in range(len(start))),
        _cover(places, start),
        np.ones(_shape(scan)),
    ]


def _cover(places: list[Array], unknowns: Array) -> Array:
    """Share of a voxel covered by the ball; parameters: centre, radius, blur along and across (6,)."""
    z, y, x = np.meshgrid(*places, indexing="ij", sparse=True)
    dz, dy, dx = z - unknowns[0], y - unknowns[1], x - unknowns[2]
    distance = np.sqrt(dz**2 + dy**2 + dx**2)
    radius, along, across = unknowns[3:]
    steep = (dz / np.maximum(distance, STEP)) ** 2
    variance = across**2 + (along**2 - across**2) * steep
    bend = (along**2 + 2.0 * across**2 - variance) / (2.0 * np.maximum(distance, across))
    return np.asarray(0.5 * erfc((distance + bend - radius) / np.sqrt(2.0 * variance)))


def _noise_power(scan: BallScan) -> Array:
    """The spectrum of the phantom's noise, HU² per voxel: white, smoothed by three taps along two axes."""
    side = exp(-0.5 * (scan.pixel_mm / PLANE_SIGMA_MM) ** 2)
    gains = [
        (1.0 + 2.0 * side * np.cos(2.0 * np.pi * np.fft.fftfreq(count))) ** 2 / (1.0 + 2.0 * side**2)
        for count in _shape(scan)[1:]
    ]
    plane = gains[0][:, None] * gains[1][None, :]
    return np.asarray(scan.noise_hu**2 * np.broadcast_to(plane, _shape(scan)))
