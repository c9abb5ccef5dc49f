"""Reduced images and edge points; the only module here that calls OpenCV."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

GreyImage = NDArray[np.uint8] | NDArray[np.uint16]

SMOOTHING_PX = 1.0  # Gaussian on the reduced image, against grain
GREY_LEVELS = 255.0
NOISE_SAMPLING = 3  # every third pixel suffices to estimate the noise
STRONG_PERCENTILE = 99.5
STRONG_SHARE = 0.2  # an edge has at least this share of the strong gradients ...
NOISE_FACTOR = 6.0  # ... and this many times the typical gradient, unless that is more than ...
NOISY_SHARE = 0.5  # ... this share of the strong gradients
GRADIENT_FLOOR = 24.0  # Sobel units of an image stretched to 0..255: a step of six grey levels
WEAK_SHARE = 0.5  # Canny's lower threshold relative to the upper


@dataclass(frozen=True)
class EdgePoints:
    """Edge pixels of a reduced image: (n, 2) positions x, y and (n, 2) unit gradients (towards bright)."""

    position_px: NDArray[np.float64]
    direction: NDArray[np.float64]


def halved(image: GreyImage, times: int) -> GreyImage:
    """Mean over 2 x 2 pixels, repeated `times` times; rows and columns that do not fill a block are dropped.

    With f = 2 ** times, pixel u of the result is centred at `f * (u + 0.5) - 0.5` of the image. Halving
    repeatedly takes a tenth of the time of a single step, and rounding stays below one grey level.
    """
    factor = 2**times
    height, width = (side // factor * factor for side in image.shape)
    reduced: GreyImage = np.ascontiguousarray(image[:height, :width])  # type: ignore[assignment]
    with _in_this_thread():
        for _ in range(times):
            height, width = height // 2, width // 2
            reduced = cv2.resize(reduced, (width, height), interpolation=cv2.INTER_AREA)
    return reduced


def find_edges(image: GreyImage, dark: float, bright: float) -> EdgePoints:
    """Thin edges of an image after stretching its grey values from dark..bright to 0..255."""
    gain = GREY_LEVELS / max(bright - dark, 1.0)
    stretched = np.clip((image.astype(np.float32) - dark) * gain, 0.0, GREY_LEVELS).astype(np.uint8)
    with _in_this_thread():
        smooth = cv2.GaussianBlur(stretched, (0, 0), SMOOTHING_PX)
        slope_x = cv2.Sobel(smooth, cv2.CV_16S, 1, 0)
        slope_y = cv2.Sobel(smooth, cv2.CV_16S, 0, 1)
        upper = _edge_threshold(slope_x, slope_y)
        edges = cv2.Canny(slope_x, slope_y, WEAK_SHARE * upper, upper, L2gradient=True)
    places = cv2.findNonZero(edges)  # None if there are none; (n, 2) or (n, 1, 2) depending on the version
    position = np.asarray([] if places is None else places, dtype=np.intp).reshape(-1, 2)
    columns, rows = position[:, 0], position[:, 1]
    gradient = np.stack([slope_x[rows, columns], slope_y[rows, columns]], axis=1).astype(float)
    length = np.maximum(np.hypot(gradient[:, 0], gradient[:, 1]), 1.0)
    return EdgePoints(position.astype(float), gradient / length[:, None])


@contextmanager
def _in_this_thread() -> Iterator[None]:
    """OpenCV's worker threads busy-wait: on images this small they cost more than they save."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


def _edge_threshold(slope_x: NDArray[np.int16], slope_y: NDArray[np.int16]) -> float:
    every = slice(None, None, NOISE_SAMPLING)
    strength = np.hypot(slope_x[every, every].astype(np.float32), slope_y[every, every].astype(np.float32))
    typical = float(np.median(strength))
    strong = float(np.percentile(strength, STRONG_PERCENTILE))
    above_noise = min(NOISE_FACTOR * typical, NOISY_SHARE * strong)  # a busy background hides no sphere
    return max(above_noise, STRONG_SHARE * strong, GRADIENT_FLOOR)
