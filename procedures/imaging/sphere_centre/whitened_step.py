"""The last step of the fit: every spatial frequency of the residuals is weighted by its noise.

CT noise has low frequencies: its spectrum falls off where that of a sharp edge still carries information.
Least squares with equal weight for all voxels therefore loses accuracy. Generalized least squares weights the
residuals by the inverse of the measured noise spectrum (Aitken 1935; in imaging, the prewhitening observer).
Where the voxels end, a filter would take the end of a smooth term for detail: those terms are not filtered.
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
Pull = Callable[[Array], Array]  # parameters (m,) to weighted residuals w·r (n,)

STEPS = 2
MOST_MOVED_MM = 0.5  # the previous fit cannot have been off by more


@dataclass(frozen=True, eq=False)
class WhitenedStep:
    """Estimating equations for parameters (m,), the first three a position in mm, from n voxels.

    Each of the `instruments` (n, m) times the weighted residuals must vanish or, for a parameter shrunk
    towards 0 with `stiffness` (m,), equal the restoring term. `response` (m, m) is the derivative of these
    sums with respect to the parameters, `noise` (m, m) their uncertainty.
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
        """From weighted derivatives (n, m) at a robust fit and their spectra; nothing is shrunk.

        `growth` is the growth of the weighted residual with the residual, relative to its weight; `smooth`
        (m,) marks the derivatives that are smooth where the voxels end.
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
        """The same with parameters shrunk towards 0."""
        return replace(self, stiffness=stiffness)

    @cached_property
    def answer(self) -> Array:
        """Response of the parameters to the sums, (m, m)."""
        return np.asarray(np.linalg.pinv(self.response + np.diag(self.stiffness)))

    @property
    def covariance(self) -> Array:
        """Covariance of the parameters due to noise, (m, m)."""
        return np.asarray(self.answer @ self.noise @ self.answer.T)

    @property
    def influence(self) -> Array:
        """Shift of the centre per HU of weighted residual at each voxel, (n, 3) mm."""
        return np.asarray(self.instruments @ self.answer[:3].T)

    def settle(self, unknowns: Array, pull: Pull) -> Array | None:
        """The solution of the equations near given parameters; None if it is somewhere else."""
        settled = unknowns
        for _ in range(STEPS):
            sums = self.instruments.T @ pull(settled)
            settled = settled + self.answer @ (sums - self.stiffness * settled)
        return settled if np.abs(settled[:3] - unknowns[:3]).max() < MOST_MOVED_MM else None
