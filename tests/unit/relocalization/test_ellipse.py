"""The robust ellipse: exact points, partial arcs, outliers, and points that define no ellipse."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from procedures.relocalization.ellipse import circle_as_ellipse, fit_ellipse

CENTRE = (400.3, 210.7)


def rim(major=261.0, minor=255.0, turn_deg=30.0, angles=None):
    angle = np.linspace(0, 2 * np.pi, 240, endpoint=False) if angles is None else angles
    points = np.column_stack([major * np.cos(angle), minor * np.sin(angle), np.zeros_like(angle)])
    return Rotation.from_euler("z", turn_deg, degrees=True).apply(points)[:, :2] + CENTRE


def test_exact_points_give_the_exact_ellipse():
    fit = fit_ellipse(rim(), circle_as_ellipse((404.0, 206.0), 250.0))
    assert fit.ellipse.centre_px == pytest.approx(CENTRE, abs=1e-6)
    assert fit.ellipse.axes_px == pytest.approx((261.0, 255.0), abs=1e-6)
    assert np.abs(fit.ellipse.distance_px(rim())).max() < 1e-6


def test_two_thirds_of_the_rim_are_enough():
    fit = fit_ellipse(rim(angles=np.linspace(0.3, 4.5, 160)), circle_as_ellipse((402.0, 209.0), 258.0))
    assert fit.ellipse.centre_px == pytest.approx(CENTRE, abs=1e-4)


def test_outliers_on_a_fifth_of_the_rim_do_not_pull_the_centre():
    points = rim(major=261.4, minor=261.0)  # as round as a sphere's outline
    generator = np.random.default_rng(1)
    points += generator.normal(0, 0.03, points.shape)
    points[:48] = CENTRE + 0.98 * (points[:48] - CENTRE)
    fit = fit_ellipse(points, circle_as_ellipse((401.0, 210.0), 258.0))
    assert np.hypot(*(np.array(fit.ellipse.centre_px) - CENTRE)) < 0.03
    assert np.all(fit.weights[:48] < 0.05)


@pytest.mark.slow
def test_the_centre_covariance_matches_the_noise():
    generator = np.random.default_rng(4)
    centres, predicted = [], []
    for _ in range(200):
        points = rim()
        fit = fit_ellipse(points + generator.normal(0, 0.1, points.shape), circle_as_ellipse(CENTRE, 258.0))
        centres.append(fit.ellipse.centre_px)
        predicted.append(np.diag(fit.centre_covariance_px2))
    assert np.var(centres, axis=0) == pytest.approx(np.mean(predicted, axis=0), rel=0.35)


def test_the_radius_follows_the_shape():
    fit = fit_ellipse(rim(turn_deg=0.0), circle_as_ellipse(CENTRE, 258.0))
    assert fit.ellipse.radius_at(np.array([0.0, np.pi / 2])) == pytest.approx([261.0, 255.0], abs=1e-6)


@pytest.mark.parametrize("points", [np.zeros((4, 2)), np.column_stack([np.arange(50.0), np.arange(50.0)])])
def test_points_that_define_no_ellipse_give_none(points):
    assert fit_ellipse(points, circle_as_ellipse((10.0, 10.0), 20.0)) is None
