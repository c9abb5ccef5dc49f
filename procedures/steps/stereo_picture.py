"""Keeps the last stereo pair of a sphere as a picture with the fitted outlines, for the report."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from procedures.engine.case import PICTURES_FOLDER
from procedures.engine.step import StepContext
from procedures.relocalization.sphere import SphereImage
from procedures.steps.stereo_look import Look
from ronna_hw.devices.readings import CameraImage
from ronna_hw.records import write_whole

PICTURE_HEIGHT_PX = 300
FIT_COLOUR_BGR = (80, 220, 80)
GAP_PX = 8


def keep_picture(context: StepContext, fiducial: int, seen: Look) -> None:
    """Write `pictures/stereo-<trajectory>-<fiducial>.png` into the run folder."""
    if seen.left is None or seen.right is None:
        return
    folder = context.case.folder / PICTURES_FOLDER
    folder.mkdir(exist_ok=True)
    write_whole(folder / f"stereo-{context.key.trajectory}-{fiducial + 1}.png", pair_picture(seen))


def pair_picture(seen: Look) -> bytes:
    """Both images side by side as PNG, with the outlines that were fitted; a missing side is left out."""
    sides = ((seen.reading.left, seen.left), (seen.reading.right, seen.right))
    drawn = [_draw(image, sphere) for image, sphere in sides if image is not None]
    height = min((picture.shape[0] for picture in drawn), default=PICTURE_HEIGHT_PX)
    gap = np.full((height, GAP_PX, 3), 255, dtype=np.uint8)
    parts = [part for picture in drawn for part in (gap, picture[:height])]
    picture = np.hstack([*parts[1:], *([] if parts else [gap])])
    _, content = cv2.imencode(".png", picture)
    return content.tobytes()


def _draw(image: CameraImage, sphere: SphereImage | None) -> NDArray[np.uint8]:
    pixels = image.pixels
    eight_bit = pixels if pixels.dtype == np.uint8 else (pixels >> 4).astype(np.uint8)
    scale = PICTURE_HEIGHT_PX / pixels.shape[0]
    small = cv2.resize(eight_bit, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    colour = cv2.cvtColor(small, cv2.COLOR_GRAY2BGR)
    if sphere is None:
        return np.asarray(colour, dtype=np.uint8)
    x = (sphere.centre_px[0] - image.area.offset_x) * scale
    y = (sphere.centre_px[1] - image.area.offset_y) * scale
    radius = round(scale * (sphere.axes_px[0] + sphere.axes_px[1]) / 2)
    centre = (round(x), round(y))
    cv2.circle(colour, centre, radius, FIT_COLOUR_BGR, 1, cv2.LINE_AA)
    cv2.drawMarker(colour, centre, FIT_COLOUR_BGR, cv2.MARKER_CROSS, 14, 1, cv2.LINE_AA)
    drawn: NDArray[np.uint8] = np.asarray(colour, dtype=np.uint8)
    return drawn
