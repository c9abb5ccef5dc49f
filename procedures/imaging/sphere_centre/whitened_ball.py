"""Refines the robust ball fit: noise and streaks are estimated from the image and accounted for.

The noise spectrum is measured on the residuals of a fit with an unconstrained background bend. The size of
the bend shows how strong metal streaks are; bends are then shrunk towards 0 accordingly, and slopes likewise.
What streaks of unknown shape leave behind counts as additional white noise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.sphere_centre.ball_model import IN, RADIUS, SLOPE, SXY, SZ
from procedures.imaging.sphere_centre.ball_voxels import BallVoxels
from procedures.imaging.sphere_centre.noise_covariance import WINDOW_MM, CorrelatedNoise
from procedures.imaging.sphere_centre.streak_background import BENT, StreakPrior
from procedures.imaging.sphere_centre.voxel_spectra import VoxelGrid
from procedures.imaging.sphere_centre.whitened_step import WhitenedStep

Array = NDArray[np.float64]

EDGE = [0, 1, 2, IN, SZ, SXY, RADIUS]  # parameters of the ball's edge; the others are smooth where voxels end
# Share of the variance: no frequency counts as less noisy than this, since no window measures and no model
# fits more finely; 0.03 would gain 1 % on the phantom's noise. If much of a ball is covered, the cover is the
# limit, not noise: then all frequencies count nearly alike, chosen on balls half buried in 20 to 60 HU.
LEAST_POWER, LEAST_POWER_COVERED = 0.1, 3.0
# power (HU² per voxel) that bend terms of 1 HU² leave, chosen on streaks of one, two and six lobes around a
# post: without it whitening takes their remains for signal, and errors grow by half
STREAK_POWER = 8.0
MIN_VARIANCE_MM2 = 1e-8  # 0.1 µm: keeps the result positive definite on noise-free data


@dataclass(frozen=True, eq=False)
class WhitenedBall:
    """The parameters, the covariance of the centre in grid mm; noise and typical background bend in HU."""

    unknowns: Array
    covariance_mm2: Array
    noise_hu: float
    streak_hu: float


def fit_whitened(voxels: BallVoxels, start: Array, *, most_streak_hu: float = np.inf) -> WhitenedBall | None:
    """The best fit near a robust one; None without one, or if streaks bend more than `most_streak_hu`."""
    derivatives, pull, weights, noise_hu = voxels.at(start)
    derivatives *= weights[:, None]
    smooth = np.ones(len(start), dtype=bool)
    smooth[EDGE] = False
    grid = VoxelGrid.around(voxels.where, WINDOW_MM, voxels.spacing_mm)
    spectra = grid.spectra(derivatives)
    least = LEAST_POWER_COVERED if voxels.covered else LEAST_POWER
    noise = CorrelatedNoise.of_fit(grid, pull, spectra, least)
    growth = voxels.growth(weights)

    def pull_at(unknowns: Array) -> Array:
        return voxels.at(unknowns)[1]

    step = WhitenedStep.of_fit(noise, derivatives, spectra, growth, smooth)
    settled = step.settle(start, pull_at)
    if settled is None:
        return None
    prior = StreakPrior.of_bends(settled[BENT], step.covariance[BENT, BENT])
    if prior.streak_hu > most_streak_hu:
        return None
    if prior.bent_hu2 > 0.0:
        noise = noise.with_more(STREAK_POWER * prior.bent_hu2)
        step = WhitenedStep.of_fit(noise, derivatives, spectra, growth, smooth)
    step = step.drawn(prior.stiffness(len(start)))
    settled = step.settle(settled, pull_at)
    if settled is None:
        return None
    prior = prior.with_slopes(settled[SLOPE], step.covariance[SLOPE, SLOPE])
    step = step.drawn(prior.stiffness(len(start)))
    settled = step.settle(settled, pull_at)
    if settled is None:
        return None
    by_streaks = prior.covariance_mm2(step.answer, step.influence, weights, voxels.places)
    covariance_mm2 = step.covariance[:3, :3] + by_streaks + MIN_VARIANCE_MM2 * np.eye(3)
    return WhitenedBall(settled, covariance_mm2, noise_hu, prior.streak_hu)
