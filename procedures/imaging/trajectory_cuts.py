"""Three CT planes through a target with the planned trajectories, for confirmation, report and operation."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from procedures.imaging.volume import Volume
from ronna_hw.arrays import Array

Picture = NDArray[np.uint8]

PLAN_PICTURE = "plan-"  # prefix of the file names, followed by the trajectory
HALF_WIDTH_MM = 120.0  # of a plane, about the head's middle: a head and what is mounted on it
STEP_MM = 0.9
WINDOW_HU = (-300.0, 1300.0)
UNSCANNED_HU = -1000
DEPTH_MM = 12.0  # from the plane, at which a trajectory has faded to a third
FAINTEST = 0.12  # of a trajectory's opacity, at any distance from the plane
PIECES = 40  # per drawn trajectory
OWN_BGR, OTHER_BGR, TARGET_BGR, LETTER_BGR = (162, 95, 255), (255, 166, 88), (60, 220, 255), (255, 255, 255)
GAP_PX = 6
# Scales of the font, whose capitals are 21 px high at 1: on a page a plane may be shown in half its size.
SIDE_SCALE, TITLE_SCALE = 0.95, 0.6
# Radiological convention: name, direction to the right and down in LPS, letters left, right, top, bottom.
PLANES = (
    ("axial", (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), ("R", "L", "A", "P")),
    ("coronal", (1.0, 0.0, 0.0), (0.0, 0.0, -1.0), ("R", "L", "S", "I")),
    ("sagittal", (0.0, 1.0, 0.0), (0.0, 0.0, -1.0), ("A", "P", "S", "I")),
)
Line = tuple[Array, Array]  # entry and target, LPS mm


def trajectory_cuts(volume: Volume, lines: Mapping[str, Line], name: str, head_mm: Array) -> bytes:
    """Draw a PNG with the axial, coronal and sagittal planes through the target of trajectory `name`.

    `lines` are entry and target, LPS mm, by name; each fades with its distance from the plane. Each plane
    is shown about the head's middle `head_mm`, so that the whole head is in it wherever the target lies.
    """
    import cv2

    gap = np.zeros((2 * round(HALF_WIDTH_MM / STEP_MM) + 1, GAP_PX, 3), np.uint8)
    parts: list[Picture] = []
    for title, right, down, letters in PLANES:
        axes, target = np.array([right, down]), lines[name][1]
        middle = target + (head_mm - target) @ axes.T @ axes  # in the plane through the target
        picture = _sample_plane(volume, middle, *axes)
        for other, line in sorted(lines.items(), key=lambda one: one[0] == name):  # own trajectory on top
            _draw_line(picture, line, middle, axes, is_own=other == name)
        _write(picture, f"{name} {title}", letters)
        parts += [gap, picture]
    _, content = cv2.imencode(".png", np.hstack(parts[1:]))
    return content.tobytes()


def _sample_plane(volume: Volume, middle_mm: Array, right: Array, down: Array) -> Picture:
    """Sample grey values (n, n, 3) on a plane around a point."""
    offsets = np.arange(-round(HALF_WIDTH_MM / STEP_MM), round(HALF_WIDTH_MM / STEP_MM) + 1) * STEP_MM
    places = middle_mm + offsets[:, None, None] * down + offsets[None, :, None] * right
    values = volume.sample(places, UNSCANNED_HU)
    low, high = WINDOW_HU
    grey = (255.0 * np.clip((values - low) / (high - low), 0.0, 1.0)).astype(np.uint8)
    return np.repeat(grey[:, :, None], 3, axis=2)


def _draw_line(picture: Picture, line: Line, middle_mm: Array, axes: Array, *, is_own: bool) -> None:
    """Draw a trajectory from entry to target in short segments."""
    import cv2

    entry, target = line
    across = np.cross(*axes)
    shares = np.linspace(0.0, 1.0, PIECES + 1)[:, None]
    places = entry + shares * (target - entry) - middle_mm
    pixels = places @ axes.T / STEP_MM + picture.shape[0] // 2
    ink = np.array(OWN_BGR if is_own else OTHER_BGR, dtype=float)
    for start, end, place in zip(pixels, pixels[1:], places, strict=False):
        share = max(FAINTEST, float(np.exp(-abs(place @ across) / DEPTH_MM)))
        background = picture[_clamp(picture, start[1]), _clamp(picture, start[0])].astype(float)
        colour = tuple(float(one) for one in share * ink + (1.0 - share) * background)
        cv2.line(picture, _round_pixel(start), _round_pixel(end), colour, 2 if is_own else 1, cv2.LINE_AA)
    if is_own:
        cv2.drawMarker(picture, _round_pixel(pixels[-1]), TARGET_BGR, cv2.MARKER_CROSS, 13, 1, cv2.LINE_AA)


def _round_pixel(pixel: Array) -> tuple[int, int]:
    return round(float(pixel[0])), round(float(pixel[1]))


def _clamp(picture: Picture, pixel: float) -> int:
    return int(min(max(pixel, 0), picture.shape[0] - 1))


def _write(picture: Picture, title: str, letters: tuple[str, str, str, str]) -> None:
    """Write the plane's name, and the patient's sides at the edges."""
    import cv2

    size = picture.shape[0]
    left, right, top, bottom = letters
    middle, low = size // 2, size - 6
    sides = ((left, (5, middle)), (right, (size - 23, middle)), (top, (middle, 24)), (bottom, (middle, low)))
    for words, place in sides:
        cv2.putText(picture, words, place, cv2.FONT_HERSHEY_SIMPLEX, SIDE_SCALE, LETTER_BGR, 2, cv2.LINE_AA)
    cv2.putText(picture, title, (5, 18), cv2.FONT_HERSHEY_SIMPLEX, TITLE_SCALE, LETTER_BGR, 1, cv2.LINE_AA)
