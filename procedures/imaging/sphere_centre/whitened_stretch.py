"""Stretch of a fitted ball by generalized least squares, with the covariance of its five terms.

Blur sets the width of an edge and stretch its place, so both blurs stay free beside the stretch, as do the
radius (a film moves the edge alike on all sides) and the background. Noise is weighted by its measured
spectrum, streaks by the prior of the ball's own fit.
"""

from __future__ import annotations

import numpy as np

from procedures.imaging.sphere_centre.ball_model import (
    RADIUS,
    SZ,
    BallVoxels,
    Stretch,
    products,
    stretch_terms,
)
from procedures.imaging.sphere_centre.correlated_noise import CorrelatedNoise, WhitenedStep
from procedures.imaging.sphere_centre.streak_prior import StreakPrior
from ronna_hw.arrays import Array

HIDDEN_DEGREES = (4,)  # of streaks: odd terms do not stretch a ball


def measure_stretch(
    voxels: BallVoxels,
    unknowns: Array,
    noise: CorrelatedNoise,
    step: WhitenedStep,
    streaks: StreakPrior,
) -> Stretch:
    """Measure the stretch at the parameters (m,) that a whitened fit has settled on, in its last `step`."""
    derivatives, pull, weights = voxels.evaluate(unknowns)
    derivatives *= weights[:, None]
    directions = voxels.points_mm - unknowns[:3]
    directions /= np.maximum(np.linalg.norm(directions, axis=1, keepdims=True), 1e-6)
    columns = derivatives[:, RADIUS, None] * stretch_terms(directions)
    count = columns.shape[1]
    instruments = np.column_stack(
        (step.instruments, noise.grid.values(noise.grid.spectra(columns) / noise.power))
    )
    response = voxels.growth(weights) * products(instruments, np.column_stack((derivatives, columns)))
    stiffness = np.append(step.stiffness, np.zeros(count))
    answer = np.asarray(np.linalg.pinv(response + np.diag(stiffness))[-count:])
    found = answer @ (instruments.T @ pull - stiffness * np.append(unknowns, np.zeros(count)))
    influence = np.asarray(instruments @ answer.T)
    spectra = noise.grid.spectra(influence)
    covariance = noise.grid.products(spectra, spectra, noise.power)
    covariance += streaks.covariance_mm2(answer, influence, weights, voxels.places, HIDDEN_DEGREES)
    return Stretch.from_terms(found, covariance, float(unknowns[SZ]))
