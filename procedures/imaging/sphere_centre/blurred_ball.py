"""Second sphere centre estimator: a blurred ball fitted directly to the voxels.

The parameters are the centre, both intensities, both blurs, the radius and the background. Voxels near metal
are excluded. A robust fit, insensitive to post and skin, finds voxels foreign to the ball; a fit with a
model of noise and streaks then makes full use of the rest.

The noise spectrum is measured on the residuals of a fit with an unconstrained background bend. The size of
the bend shows how strong metal streaks are (`streak_prior`); it and the slopes are then shrunk. Remains of
streaks of unknown shape count as additional white noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from procedures.imaging.sphere_centre.ball_model import (
    BALL,
    HIDDEN_DEPTH_MM,
    IN,
    MIN_VOXELS,
    OUT,
    RADIUS,
    SLOPE,
    SXY,
    SZ,
    TERMS,
    BallVoxels,
    Stretch,
    add_stretch_derivatives,
    guess_ball,
    mark_directions,
    products,
    select_ball_voxels,
)
from procedures.imaging.sphere_centre.correlated_noise import (
    WINDOW_MM,
    CorrelatedNoise,
    VoxelGrid,
    WhitenedStep,
)
from procedures.imaging.sphere_centre.radial_edge import RadialEdge
from procedures.imaging.sphere_centre.streak_prior import BENT, StreakPrior
from procedures.imaging.volume import Region
from ronna_hw.arrays import Array

HIDDEN_DEGREES = (5,)  # of streaks: even terms do not move the centre of a ball ...
STRETCH_HIDDEN_DEGREES = (4,)  # ... and odd ones do not stretch it

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
class BlurredBall:
    """Fitted ball. Centre and covariance in grid mm (slice, row, column), intensities in HU."""

    centre_mm: Array
    covariance_mm2: Array
    radius_mm: float
    metal_share: float  # part of the sphere's surface too close to metal to be used
    streak_hu: float  # typical size, at the surface, of the terms by which streaks bend the background
    contrast_hu: float
    stretch: Stretch  # where the surface borders on the outside, against a body of another shape
    deformation: Stretch  # with its covariance, against a scan that is out of shape


def fit_rough_ball(
    region: Region, edge: RadialEdge, *, hidden_directions: Array | None = None
) -> RoughBall | None:
    """Fit a ball from its edge, accurate to 0.3 mm; return None if the fit fails or has too few voxels.

    In `hidden_directions` (n, 3) from the centre, the surface borders on something other than the outside;
    voxels near and beyond the surface there are excluded.
    """
    usable, metal_share = select_ball_voxels(region, edge.centre_mm, edge.radius_mm, hidden_directions)
    if usable.sum() < MIN_VOXELS:
        return None
    covered = hidden_directions is not None and len(hidden_directions) > 0
    voxels = BallVoxels.of(region, usable, edge.radius_mm, covered=covered)
    settled = voxels.fit_robustly(guess_ball(region, edge))
    return None if settled is None else RoughBall(voxels, settled, metal_share)


@dataclass(frozen=True, eq=False)
class RoughBall:
    """Result of the robust fit: the voxels used and all parameters."""

    voxels: BallVoxels
    unknowns: Array
    metal_share: float

    @property
    def contrast_hu(self) -> float:
        """Contrast between the ball and its surroundings."""
        return abs(float(self.unknowns[IN] - self.unknowns[OUT]))

    @property
    def background_unevenness(self) -> float:
        """Norm of the background's slope and bend terms over one radius, relative to the contrast."""
        return float(np.linalg.norm(self.unknowns[BALL:])) / self.contrast_hu

    def refined(self, hidden_directions: Array, *, most_streaks: float = np.inf) -> BlurredBall | None:
        """Refine the fit; return None if it fails or if streaks exceed `most_streaks`, of the contrast.

        `hidden_directions` (n, 3) are directions without information about the shape.
        """
        voxels, most_hu = self.voxels.without_outliers(self.unknowns), most_streaks * self.contrast_hu
        fitted = fit_whitened(voxels, self.unknowns, most_streak_hu=most_hu)
        if fitted is None:
            return None
        unknowns = fitted.unknowns
        outer = self.voxels.distance_outside_mm(unknowns) > -HIDDEN_DEPTH_MM
        clear = ~mark_directions(self.voxels.points_mm - unknowns[:3], hidden_directions, outer)
        return BlurredBall(
            centre_mm=unknowns[:3],
            covariance_mm2=fitted.covariance_mm2,
            radius_mm=float(unknowns[RADIUS]),
            metal_share=self.metal_share,
            streak_hu=fitted.streak_hu,
            contrast_hu=float(unknowns[IN] - unknowns[OUT]),
            stretch=self.voxels.stretch(unknowns, clear),
            deformation=fitted.stretch,
        )


@dataclass(frozen=True, eq=False)
class WhitenedBall:
    """Refined parameters, covariance of the centre in grid mm², typical background bend in HU, stretch."""

    unknowns: Array
    covariance_mm2: Array
    streak_hu: float
    stretch: Stretch


def fit_whitened(voxels: BallVoxels, start: Array, *, most_streak_hu: float = np.inf) -> WhitenedBall | None:
    """Refine a robust fit; return None if it fails or if the bend exceeds `most_streak_hu`."""
    derivatives, pull, weights = voxels.evaluate(start)
    derivatives *= weights[:, None]
    smooth = np.ones(len(start), dtype=bool)
    smooth[EDGE] = False
    grid = VoxelGrid.from_indices(voxels.voxel_index, WINDOW_MM, voxels.spacing_mm)
    spectra = grid.spectra(derivatives)
    least = LEAST_POWER_COVERED if voxels.covered else LEAST_POWER
    noise = CorrelatedNoise.from_fit(grid, pull, spectra, least)
    growth = voxels.growth(weights)

    def compute_pull(unknowns: Array) -> Array:
        return voxels.evaluate(unknowns)[1]

    step = WhitenedStep.from_fit(noise, derivatives, spectra, growth, smooth)
    settled = step.settle(start, compute_pull)
    if settled is None:
        return None
    prior = StreakPrior.from_bends(settled[BENT], step.covariance[BENT, BENT])
    if prior.streak_hu > most_streak_hu:
        return None
    if prior.bent_hu2 > 0.0:
        noise = replace(noise, power=noise.power + STREAK_POWER * prior.bent_hu2)
        step = WhitenedStep.from_fit(noise, derivatives, spectra, growth, smooth)
    step = replace(step, stiffness=prior.stiffness(len(start)))
    settled = step.settle(settled, compute_pull)
    if settled is None:
        return None
    prior = prior.with_slopes(settled[SLOPE], step.covariance[SLOPE, SLOPE])
    step = replace(step, stiffness=prior.stiffness(len(start)))
    settled = step.settle(settled, compute_pull)
    if settled is None:
        return None
    by_streaks = prior.covariance_mm2(step.answer[:3], step.influence, weights, voxels.places, HIDDEN_DEGREES)
    covariance_mm2 = step.covariance[:3, :3] + by_streaks + MIN_VARIANCE_MM2 * np.eye(3)
    stretch = measure_stretch(voxels, settled, noise, step, prior)
    return WhitenedBall(settled, covariance_mm2, prior.streak_hu, stretch)


def measure_stretch(
    voxels: BallVoxels, unknowns: Array, noise: CorrelatedNoise, step: WhitenedStep, streaks: StreakPrior
) -> Stretch:
    """Measure the stretch at the parameters (m,) that a whitened fit has settled on, in its last `step`.

    Blur sets the width of an edge and stretch its place, so both blurs stay free beside the stretch, as do
    the radius (a film moves the edge alike on all sides) and the background. Noise is weighted by its
    measured spectrum, streaks by the prior of the ball's own fit.
    """
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
    covariance += streaks.covariance_mm2(answer, influence, weights, voxels.places, STRETCH_HIDDEN_DEGREES)
    return Stretch(found, covariance, float(unknowns[SZ]))
