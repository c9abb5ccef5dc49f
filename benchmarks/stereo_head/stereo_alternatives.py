"""The usual first attempts at a disc's centre, with OpenCV, and the smallest possible error."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from procedures.relocalization import SphereImage
from procedures.relocalization.triangulation import Camera

Array = NDArray[np.float64]
Picture = NDArray[np.uint8]

RADIUS_TOLERANCE = 0.15
FULL_WELL_ELECTRONS, READ_NOISE_ELECTRONS = 11900.0, 13.5


def hough(picture: Picture, radius_px: float) -> Array:
    """`cv2.HoughCircles`, given the true radius to 15 %."""
    circles = cv2.HoughCircles(
        cv2.GaussianBlur(picture, (5, 5), 0),
        cv2.HOUGH_GRADIENT,
        dp=1,
        minDist=2 * radius_px,
        param1=100,
        param2=15,
        minRadius=round(radius_px * (1 - RADIUS_TOLERANCE)),
        maxRadius=round(radius_px * (1 + RADIUS_TOLERANCE)),
    )
    if circles is None:
        raise RuntimeError("HoughCircles found nothing")
    return np.asarray(circles, dtype=float).reshape(-1, 3)[0, :2]


def centroid(picture: Picture, _radius_px: float) -> Array:
    """Otsu's threshold, then the centroid of the largest bright area."""
    _, mask = cv2.threshold(picture, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    _, _, statistics, centres = cv2.connectedComponentsWithStats(mask)
    largest = 1 + int(np.argmax(statistics[1:, cv2.CC_STAT_AREA]))
    return np.asarray(centres[largest], dtype=float)


def contour_ellipse(picture: Picture, _radius_px: float) -> Array:
    """Otsu's threshold, the longest contour, `cv2.fitEllipseDirect`."""
    _, mask = cv2.threshold(picture, 0, 255, cv2.THRESH_BINARY + cv2.THRESH_OTSU)
    contours, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    (x, y), _, _ = cv2.fitEllipseDirect(max(contours, key=len))
    return np.array([x, y], dtype=float)


def triangulated(cameras: tuple[Camera, Camera], centres_px: tuple[Array, Array]) -> Array:
    """The simple way: outline centres, distortion removed, no perspective bias, linear least squares."""
    rays = [camera.undistorted(centre)[:, None] for camera, centre in zip(cameras, centres_px, strict=True)]
    poses = [np.column_stack([camera.rotation, camera.translation_mm]) for camera in cameras]
    point = cv2.triangulatePoints(poses[0], poses[1], rays[0], rays[1]).ravel()
    return np.asarray(point[:3] / point[3], dtype=float)


def least_error_px(sphere: SphereImage, bright_grey: float, dark_grey: float, gain: float) -> float:
    """Cramér-Rao bound of the centre along one axis, px, at shot, read and rounding noise.

    sigma_x = (sigma / C) sqrt(2 sqrt(pi) s / (pi R)) for a disc of contrast C and radius R behind a blur of
    standard deviation s, noise sigma per pixel; grain, post and unknown grey levels are ignored.
    """
    electrons_per_grey = FULL_WELL_ELECTRONS / 255.0 / gain
    electrons = (bright_grey + dark_grey) / 2.0 * electrons_per_grey  # at the rim
    noise_grey = np.hypot(np.sqrt(electrons + READ_NOISE_ELECTRONS**2) / electrons_per_grey, 12**-0.5)
    radius = float(np.mean(sphere.axes_px))
    share = 2.0 * np.sqrt(np.pi) * sphere.blur_px / (np.pi * radius)
    return float(noise_grey / (bright_grey - dark_grey) * np.sqrt(share))
