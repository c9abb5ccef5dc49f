"""Picture of a registration in the CT: spheres where the CT has them, and where they were found.

Three projections of the brightest voxels, so that every sphere is seen at once. What was found is some tenths
of a millimetre away: the deviations are drawn larger than they are, by a factor that is written beside.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from procedures.imaging.trajectory_cuts import GAP_PX, LETTER_BGR, PLANES, UNSCANNED_HU
from procedures.imaging.volume import Volume
from ronna_hw.arrays import Array

STEP_MM = 2.0  # of the projection: its voxels are a background
PIXELS = 4  # per step
WINDOW_HU = (-900.0, 3200.0)  # spheres and posts are grey, the brightest bone does not hide letters
MARGIN_MM = 25.0  # around the outermost sphere
SPHERE_RADIUS_MM = 5.75
MAGNIFIED = 100  # a deviation of 0.1 mm is 10 mm on the picture
EXPECTED_BGR, FOUND_BGR, EDGE_BGR = (255, 166, 88), (60, 220, 255), (0, 0, 0)
TEXT = 0.45  # size of the letters, as OpenCV counts
LEGEND_PX = 22

Picture = NDArray[np.uint8]


def project_spheres(
    volume: Volume | None, expected_mm: ArrayLike, found_mm: ArrayLike, names: Sequence[str]
) -> bytes:
    """Draw a PNG of spheres (n, 3), LPS mm, at their places in the CT and as found; NaN for one not found.

    Without a volume the background is black.
    """
    import cv2

    expected, found = (np.asarray(one, dtype=float).reshape(-1, 3) for one in (expected_mm, found_mm))
    low, high = expected.min(axis=0) - MARGIN_MM, expected.max(axis=0) + MARGIN_MM
    middle, half_mm = (low + high) / 2.0, float((high - low).max()) / 2.0
    cube = _resample(volume, middle, half_mm)
    parts: list[Picture] = []
    for title, right, down, letters in PLANES:
        axes = np.array([right, down])
        picture = _project(cube, axes)
        _draw_spheres(picture, axes, middle, (expected, found), names)
        _write(picture, title, letters)
        parts += [np.zeros((len(picture), GAP_PX, 3), np.uint8), picture]
    planes = np.hstack(parts[1:])
    legend = np.zeros((LEGEND_PX, planes.shape[1], 3), np.uint8)
    _put(legend, f"ring: in the CT; arrow: deviation as found, x {MAGNIFIED}", (5, LEGEND_PX - 7))
    _, content = cv2.imencode(".png", np.vstack([planes, legend]))
    return content.tobytes()


def _resample(volume: Volume | None, middle_mm: Array, half_mm: float) -> NDArray[np.float32]:
    """Sample HU on a cube with axes L, P, S around a point."""
    count = 2 * round(half_mm / STEP_MM) + 1
    if volume is None:
        return np.full((count, count, count), UNSCANNED_HU, dtype=np.float32)
    offsets = (np.arange(count) - count // 2) * STEP_MM
    places = middle_mm + np.stack(np.meshgrid(offsets, offsets, offsets, indexing="ij"), axis=-1)
    return np.asarray(volume.sample(places, UNSCANNED_HU), dtype=np.float32)


def _project(cube: NDArray[np.float32], axes: Array) -> Picture:
    """Project the brightest voxels along the axis through the plane; rows go down, columns to the right."""
    import cv2

    right, down = (int(np.abs(axis).argmax()) for axis in axes)
    through = 3 - right - down
    brightest = np.moveaxis(cube, (down, right, through), (0, 1, 2)).max(axis=2)
    brightest = brightest[:: int(axes[1, down]), :: int(axes[0, right])]
    low, high = WINDOW_HU
    grey = (255.0 * np.clip((brightest - low) / (high - low), 0.0, 1.0)).astype(np.uint8)
    size = (grey.shape[1] * PIXELS, grey.shape[0] * PIXELS)
    return np.repeat(cv2.resize(grey, size, interpolation=cv2.INTER_LINEAR)[:, :, None], 3, axis=2)


def _draw_spheres(
    picture: Picture, axes: Array, middle_mm: Array, places_mm: tuple[Array, Array], names: Sequence[str]
) -> None:
    import cv2

    def pixel(place_mm: Array) -> tuple[int, int]:
        x, y = ((place_mm - middle_mm) @ axes.T / STEP_MM * PIXELS + picture.shape[0] / 2).round().tolist()
        return int(x), int(y)

    radius_px = round(SPHERE_RADIUS_MM / STEP_MM * PIXELS)
    for name, expected, found in zip(names, *places_mm, strict=True):
        x, y = pixel(expected)
        cv2.circle(picture, (x, y), radius_px, EXPECTED_BGR, 1, cv2.LINE_AA)
        _put(picture, name, (x + radius_px + 2, y - radius_px))
        if np.isfinite(found).all():
            end = pixel(expected + MAGNIFIED * (found - expected))
            cv2.arrowedLine(picture, (x, y), end, FOUND_BGR, 2, cv2.LINE_AA)


def _write(picture: Picture, title: str, letters: tuple[str, str, str, str]) -> None:
    """Write the plane's name, and the patient's sides at the edges."""
    size, middle = len(picture), len(picture) // 2
    places = ((4, middle), (size - 14, middle), (middle, 14), (middle, size - 6))
    for words, place in (*zip(letters, places, strict=True), (title, (5, 14))):
        _put(picture, words, place)


def _put(picture: Picture, words: str, place: tuple[int, int]) -> None:
    import cv2

    for colour, width in ((EDGE_BGR, 3), (LETTER_BGR, 1)):  # readable on bone too
        cv2.putText(picture, words, place, cv2.FONT_HERSHEY_SIMPLEX, TEXT, colour, width, cv2.LINE_AA)
