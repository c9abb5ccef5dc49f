"""Edges of a bright disc along rays from its centre, to a small fraction of a pixel.

First the steepest fall in brightness on each ray, then a blurred step fitted to it: background plus a sloping
inside times the complementary error function.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from procedures.relocalization.circle_search import GreyImage
from procedures.relocalization.ellipse import Ellipse

Array = NDArray[np.float64]

BLUR_FLOOR_PX = 0.5  # linear interpolation between pixels alone blurs about this much
STEP_ITERATIONS = 3  # with ten, a centre changes by less than 0.005 px
SHIFT_LIMIT_PX = 1.0  # per iteration
DAMPING = 1e-3
INVERSE_ROOT_TWO_PI = 1.0 / np.sqrt(2.0 * np.pi)


@dataclass(frozen=True)
class Profiles:
    """Grey values along rays: `grey` (rays, samples); `inside` (rays,) is False if a ray leaves the image."""

    angle_rad: Array  # (rays,)
    base_px: Array  # (rays,): distance from the centre to offset 0
    offset_px: Array  # (samples,)
    grey: Array
    inside: NDArray[np.bool_]


@dataclass(frozen=True)
class RimEdges:
    """One edge per ray: offset from the base, level outside, step height, blur, misfit of the model."""

    offset_px: Array
    dark_grey: Array
    step_grey: Array
    blur_px: Array
    misfit_grey: Array
    found: NDArray[np.bool_]


def sample_profiles(image: GreyImage, ellipse: Ellipse, rays: int, half_width_px: float) -> Profiles:
    """Sample grey values every pixel along `rays` rays, from `half_width_px` inside the rim to outside it."""
    angle: Array = np.arange(rays, dtype=float) * (2.0 * np.pi / rays)
    base = ellipse.radius_at(angle)
    offset = np.arange(-np.ceil(half_width_px), np.ceil(half_width_px) + 1.0)
    distance = base[:, None] + offset
    x = ellipse.centre_px[0] + np.cos(angle)[:, None] * distance
    y = ellipse.centre_px[1] + np.sin(angle)[:, None] * distance
    height, width = image.shape
    inside = ((x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1) & (distance > 0)).all(axis=1)
    return Profiles(angle, base, offset, _interpolate(image, x, y), inside)


def rim_points(ellipse: Ellipse, profiles: Profiles, offset_px: Array) -> Array:
    """Positions (rays, 2) of edges `offset_px` from the bases of their rays."""
    distance = profiles.base_px + offset_px
    return np.stack(
        [
            ellipse.centre_px[0] + np.cos(profiles.angle_rad) * distance,
            ellipse.centre_px[1] + np.sin(profiles.angle_rad) * distance,
        ],
        axis=1,
    )


def steepest_falls(profiles: Profiles) -> RimEdges:
    """Find the steepest fall from bright to dark on each ray, refined by a parabola's vertex."""
    fall = np.zeros_like(profiles.grey)
    fall[:, 1:-1] = 0.5 * (profiles.grey[:, :-2] - profiles.grey[:, 2:])
    rays = np.arange(len(fall))
    peak = np.clip(fall[:, 1:-1].argmax(axis=1) + 1, 2, fall.shape[1] - 3)
    before, top, after = fall[rays, peak - 1], fall[rays, peak], fall[rays, peak + 1]
    bend = before - 2.0 * top + after
    shift = np.where(bend < 0, 0.5 * (before - after) / np.minimum(bend, -1e-9), 0.0)
    offset = profiles.offset_px[peak] + np.clip(shift, -1.0, 1.0)
    samples = np.arange(fall.shape[1])
    height = np.where(np.abs(samples - peak[:, None]) <= 4, np.maximum(fall, 0.0), 0.0).sum(axis=1)
    blur = INVERSE_ROOT_TWO_PI * height / np.maximum(top, 1e-9)
    dark = profiles.grey.min(axis=1)
    return RimEdges(offset, dark, height, blur, np.zeros_like(offset), profiles.inside & (top > 0))


def fit_blurred_steps(profiles: Profiles, start: RimEdges, blur_px: float) -> RimEdges:
    """Fit `B + (A + m (s - e)) * Phi((e - s) / w)` to every ray: edge e and blur w by Gauss-Newton.

    B, A and m are linear parameters, e and w are not; all five are iterated together from the steepest falls.
    """
    s = profiles.offset_px
    grey = profiles.grey
    rays = len(grey)
    edge = start.offset_px.copy()
    width = np.full(rays, max(blur_px, BLUR_FLOOR_PX))
    dark = np.median(grey[:, -4:], axis=1)
    height = np.maximum(np.median(grey[:, :4], axis=1) - dark, 1e-3)
    slope = np.zeros(rays)
    residual = np.zeros_like(grey)
    largest = 3.0 * max(blur_px, BLUR_FLOOR_PX)
    for iteration in range(STEP_ITERATIONS + 1):
        beyond = s - edge[:, None]
        z = -beyond / width[:, None]
        cover = ndtr(z)
        plateau = height[:, None] + slope[:, None] * beyond
        residual = grey - (dark[:, None] + plateau * cover)
        if iteration == STEP_ITERATIONS:
            break
        bell = INVERSE_ROOT_TWO_PI * np.exp(-0.5 * z * z) / width[:, None]
        jacobian = np.stack(
            [
                np.ones_like(z),
                cover,
                beyond * cover,
                plateau * bell - slope[:, None] * cover,
                plateau * bell * -z,
            ],
            axis=1,
        )  # (rays, 5, samples)
        normal = jacobian @ jacobian.transpose(0, 2, 1)
        diagonal = np.einsum("nii->ni", normal)
        diagonal *= 1.0 + DAMPING
        diagonal += 1e-9
        step = np.linalg.solve(normal, jacobian @ residual[:, :, None])[:, :, 0]
        dark, height, slope = dark + step[:, 0], height + step[:, 1], slope + step[:, 2]
        edge = np.clip(edge + np.clip(step[:, 3], -SHIFT_LIMIT_PX, SHIFT_LIMIT_PX), s[0], s[-1])
        width = np.clip(width + np.clip(step[:, 4], -0.5 * width, width), 0.3 * BLUR_FLOOR_PX, largest)
    misfit = np.sqrt(np.mean(residual**2, axis=1))
    found = start.found & (height > 0) & (edge > s[1]) & (edge < s[-2])
    return RimEdges(edge, dark, height, width, misfit, found)


def _interpolate(image: GreyImage, x: Array, y: Array) -> Array:
    """Interpolate linearly; positions outside use the nearest border pixel."""
    height, width = image.shape
    x, y = np.clip(x, 0, width - 1), np.clip(y, 0, height - 1)
    column = np.minimum(x.astype(np.intp), width - 2)
    row = np.minimum(y.astype(np.intp), height - 2)
    right, down = x - column, y - row
    top = image[row, column] * (1.0 - right) + image[row, column + 1] * right
    bottom = image[row + 1, column] * (1.0 - right) + image[row + 1, column + 1] * right
    return np.asarray(top * (1.0 - down) + bottom * down, dtype=float)
