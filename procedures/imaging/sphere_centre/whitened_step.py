"""The last step of the fit: every spatial frequency of the residuals is weighted by its noise.

CT noise is slow: its spectrum falls where that of a sharp edge still has something to say. Least squares that
counts all voxels alike therefore loses accuracy to it. Generalized least squares weighs the residuals by the
inverse of the noise's spectrum, as measured (Aitken 1935; in imaging, the prewhitening observer). Where the
voxels end, a filter would take the end of a smooth term for detail: those are left as they are.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.sphere_centre.noise_covariance import CorrelatedNoise
from procedures.imaging.sphere_centre.robust_fit import products
from procedures.imaging.sphere_centre.voxel_spectra import Spectrum

Array = NDArray[np.float64]
Pull = Callable[[Array], Array]  # unknowns (m,) to the pull w·r (n,) of the residuals there

STEPS = 2
MOST_MOVED_MM = 0.5  # by this the fit before cannot have been wrong


@dataclass(frozen=True, eq=False)
class WhitenedStep:
    """Equations that say when unknowns (m,), the first three a place in mm, fit n voxels.

    Each of the `instruments` (n, m) times the pull of the residuals has to vanish, or to be what its unknown,
    drawn towards 0 with `stiffness` (m,), pulls back. `response` (m, m) is how much these sums answer to the
    unknowns, `noise` (m, m) how uncertain they are.
    """

    instruments: Array
    response: Array
    noise: Array
    stiffness: Array

    @classmethod
    def of_fit(
        cls,
        noise: CorrelatedNoise,
        derivatives: Array,
        spectra: Spectrum,
        growth: float,
        smooth: NDArray[np.bool_],
    ) -> Self:
        """From weighted derivatives (n, m) at a robust fit and their spectra; nothing is drawn.

        `growth` is how fast the pull grows with the residual, over its weight; `smooth` (m,) tells the
        derivatives that are smooth where the voxels end.
        """
        instruments = derivatives / noise.slow_power
        instruments[:, ~smooth] = noise.grid.values(spectra[~smooth] / noise.power)
        filtered = spectra / noise.slow_power
        filtered[~smooth] = noise.grid.spectra(instruments[:, ~smooth])
        return cls(
            instruments,
            growth * products(instruments, derivatives),
            noise.grid.products(filtered, filtered, noise.power),
            np.zeros(len(smooth)),
        )

    def drawn(self, stiffness: Array) -> WhitenedStep:
        """The same with unknowns that are drawn towards 0."""
        return replace(self, stiffness=stiffness)

    @cached_property
    def answer(self) -> Array:
        """How the unknowns answer to the sums, (m, m)."""
        return np.asarray(np.linalg.pinv(self.response + np.diag(self.stiffness)))

    @property
    def covariance(self) -> Array:
        """What the noise makes of the unknowns, (m, m)."""
        return np.asarray(self.answer @ self.noise @ self.answer.T)

    @property
    def influence(self) -> Array:
        """What one HU of pull at each voxel moves of the centre, (n, 3) mm."""
        return np.asarray(self.instruments @ self.answer[:3].T)

    def settle(self, unknowns: Array, pull: Pull) -> Array | None:
        """Where the equations hold, from unknowns near it; None if that is somewhere else."""
        settled = unknowns
        for _ in range(STEPS):
            sums = self.instruments.T @ pull(settled)
            settled = settled + self.answer @ (sums - self.stiffness * settled)
        return settled if np.abs(settled[:3] - unknowns[:3]).max() < MOST_MOVED_MM else None
