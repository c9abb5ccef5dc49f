"""Stretch of a fitted ball by generalized least squares, with the covariance of its five terms.

Blur sets the width of an edge and stretch its place, so both blurs stay free beside the stretch, as do the
radius (a film moves the edge alike on all sides) and the background. Noise is weighted by its measured
spectrum, streaks by the prior of the ball's own fit.
"""

from __future__ import annotations

import numpy as np

from procedures.imaging.sphere_centre.ball_model import (
    SZ,
    TERMS,
    BallVoxels,
    Stretch,
    add_stretch_derivatives,
    products,
)
from procedures.imaging.sphere_centre.correlated_noise import CorrelatedNoise, WhitenedStep
from procedures.imaging.sphere_centre.streak_prior import StreakPrior
from ronna_hw.arrays import Array

HIDDEN_DEGREES = (4,)  # of streaks: odd terms do not stretch a ball


def measure_stretch(
    voxels: BallVoxels, unknowns: Array, noise: CorrelatedNoise, step: WhitenedStep, streaks: StreakPrior
) -> Stretch:
    """Measure the stretch at the parameters (m,) that a whitened fit has settled on, in its last `step`."""
    derivatives, pull, weights = voxels.evaluate(unknowns)
    derivatives *= weights[:, None]
    derivatives = add_stretch_derivatives(voxels.points_mm, unknowns, derivatives)
    filtered = noise.grid.values(noise.grid.spectra(derivatives[:, -TERMS:]) / noise.power)
    instruments = np.column_stack((step.instruments, filtered))
    response = voxels.growth(weights) * products(instruments, derivatives)
    stiffness = np.append(step.stiffness, np.zeros(TERMS))
    answer = np.asarray(np.linalg.pinv(response + np.diag(stiffness))[-TERMS:])
    found = answer @ (instruments.T @ pull - stiffness * np.append(unknowns, np.zeros(TERMS)))
    influence = np.asarray(instruments @ answer.T)
    spectra = noise.grid.spectra(influence)
    covariance = noise.grid.products(spectra, spectra, noise.power)
    covariance += streaks.covariance_mm2(answer, influence, weights, voxels.places, HIDDEN_DEGREES)
    return Stretch(found, covariance, float(unknowns[SZ]))
