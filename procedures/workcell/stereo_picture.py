"""A stereo pair as a picture with the fitted outlines, for people."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.outline import SphereImage, SphereStatus
from procedures.workcell.stereo_look import Look
from ronna_hw.devices.readings import CameraImage

PICTURE_HEIGHT_PX = 300  # of the report
TRUSTED_BGR, DOUBTED_BGR, PAPER_BGR = (80, 220, 80), (40, 160, 255), (255, 255, 255)
GAP_PX = 8
CAPTION_PX = 22
LETTERS, LETTER_SCALE = cv2.FONT_HERSHEY_SIMPLEX, 0.4
Picture = NDArray[np.uint8]


def pair_picture(seen: Look, height_px: int = PICTURE_HEIGHT_PX) -> bytes:
    """Both images side by side as PNG, with the outlines that were fitted; a missing side is left out."""
    sides = (("left", seen.reading.left, seen.left), ("right", seen.reading.right, seen.right))
    drawn = [_draw(name, image, sphere, height_px) for name, image, sphere in sides if image is not None]
    height = min((picture.shape[0] for picture in drawn), default=height_px)
    gap = np.full((height, GAP_PX, 3), PAPER_BGR, dtype=np.uint8)
    parts = [part for picture in drawn for part in (gap, picture[:height])]
    picture = np.hstack([*parts[1:], *([] if parts else [gap])])
    _, content = cv2.imencode(".png", picture)
    return content.tobytes()


def _draw(side: str, image: CameraImage, sphere: SphereImage | None, height_px: int) -> Picture:
    pixels = image.pixels
    eight_bit = pixels if pixels.dtype == np.uint8 else (pixels >> 4).astype(np.uint8)
    scale = height_px / pixels.shape[0]
    small = cv2.resize(eight_bit, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    colour = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    caption = np.full((CAPTION_PX, colour.shape[1], 3), PAPER_BGR, dtype=np.uint8)
    words = f"{side} {image.serial}: " + ("no sphere" if sphere is None else _words(sphere))
    cv2.putText(caption, words, (2, CAPTION_PX - 7), LETTERS, LETTER_SCALE, (0, 0, 0), 1, cv2.LINE_AA)
    if sphere is not None:
        ink = TRUSTED_BGR if sphere.status is SphereStatus.OK else DOUBTED_BGR
        x = (sphere.centre_px[0] - image.area.offset_x) * scale
        y = (sphere.centre_px[1] - image.area.offset_y) * scale
        radius = round(scale * (sphere.axes_px[0] + sphere.axes_px[1]) / 2)
        centre = (round(x), round(y))
        cv2.circle(colour, centre, radius, ink, 1, cv2.LINE_AA)
        cv2.drawMarker(colour, centre, ink, cv2.MARKER_CROSS, 14, 1, cv2.LINE_AA)
    return np.asarray(np.vstack([caption, colour]), dtype=np.uint8)


def _words(sphere: SphereImage) -> str:
    x, y = sphere.centre_px
    return f"{x:.2f} {y:.2f} px, rim {sphere.rim_fraction:.0%}, {sphere.doubt or sphere.status}"
