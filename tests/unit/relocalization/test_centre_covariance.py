"""Stated error of a centre where something hides part of the rim."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.relocalization.centre_covariance import RimLight, centre_covariance
from procedures.relocalization.ellipse import circle_as_ellipse, fit_ellipse

RAYS, RADIUS_PX, NOISE_PX = 300, 261.0, 0.05
HIDDEN_RAYS, BESIDE_RAYS = 60, 4
TRIALS = 100


def look_at_rim(random, *, hidden=0, dimmed_px=0.0):
    """Return error and covariance of a centre whose rim is hidden to the right and dimmed beside that."""
    ray = np.arange(hidden // 2, RAYS - hidden // 2)
    radius_px = RADIUS_PX + NOISE_PX * random.standard_normal(len(ray))
    radius_px[:BESIDE_RAYS] -= dimmed_px
    radius_px[-BESIDE_RAYS:] -= dimmed_px
    angle = ray * (2.0 * np.pi / RAYS)
    points = np.stack([radius_px * np.cos(angle), radius_px * np.sin(angle)], axis=1)
    fit = fit_ellipse(points, circle_as_ellipse((0.0, 0.0), RADIUS_PX), rough_start=False)
    level = np.ones(len(ray))
    light = RimLight(ray, RAYS, 20.0 * level, 150.0 * level, 0.0 * level, 1.0)
    return np.array(fit.ellipse.centre_px), centre_covariance(fit, light)


def chi_square(**rim):
    """Return the mean squared error per degree of freedom by the stated covariance."""
    looks = [look_at_rim(np.random.default_rng(trial), **rim) for trial in range(TRIALS)]
    return np.mean([error @ np.linalg.solve(covariance, error) / 2.0 for error, covariance in looks])


@pytest.mark.parametrize("dimmed_px", [0.0, 0.1])
def test_the_stated_error_is_honest_where_a_fifth_is_hidden_and_the_rim_beside_it_dimmed(dimmed_px):
    assert 0.4 < chi_square(hidden=HIDDEN_RAYS, dimmed_px=dimmed_px) < 1.2


def test_a_dimmed_rim_makes_the_centre_uncertain_towards_what_hides_the_sphere():
    _, clean = look_at_rim(np.random.default_rng(3), hidden=HIDDEN_RAYS)
    _, dimmed = look_at_rim(np.random.default_rng(3), hidden=HIDDEN_RAYS, dimmed_px=0.1)
    along, across = dimmed[0][0] / clean[0][0], dimmed[1][1] / clean[1][1]
    assert along > 1.5 * across > 1.5
