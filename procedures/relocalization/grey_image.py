"""Grey images of the stereo head's cameras: 8 or 12 bits, whole or an area of the sensor."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.errors import BadImage

GreyImage = NDArray[np.uint8] | NDArray[np.uint16]

SMALLEST_SIDE_PX = 48
EIGHT_BIT_LIMIT, TWELVE_BIT_LIMIT = 255, 4095


@dataclass(frozen=True)
class AreaImage:
    """An image and the position of its top-left pixel on the sensor."""

    pixels: GreyImage
    offset_x_px: int = 0
    offset_y_px: int = 0


def validate_image(image: object) -> GreyImage:
    """Return a greyscale image of 8 or 12 bits in this machine's byte order. Raises STE-001."""
    if not isinstance(image, np.ndarray):
        raise BadImage("the image is not an array", got=type(image).__name__)
    native = image.dtype.newbyteorder("=")
    if image.ndim != 2 or native not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise BadImage("the image is not a greyscale image", got=f"{image.ndim}-D {image.dtype}")
    if min(image.shape) < SMALLEST_SIDE_PX:
        raise BadImage("the image is too small", limit=f"{SMALLEST_SIDE_PX} px", got=str(image.shape))
    if native == np.uint16 and int(image.max()) > TWELVE_BIT_LIMIT:
        raise BadImage(
            "the image has values of more than 12 bits",
            limit=f"a grey value of {TWELVE_BIT_LIMIT}",
            got=str(image.max()),
        )
    return image.astype(native, copy=False)  # OpenCV accepts only the byte order of this machine


def highest_grey(image: GreyImage) -> int:
    """Return the grey value at which a pixel is saturated."""
    return EIGHT_BIT_LIMIT if image.dtype == np.uint8 else TWELVE_BIT_LIMIT


def halve_image(image: GreyImage, times: int) -> GreyImage:
    """Average 2 x 2 pixels, `times` times, dropping rows and columns that do not fill a block.

    With f = 2 ** times, pixel u of the result is centred at `f * (u + 0.5) - 0.5` of the image. Halving
    repeatedly takes a tenth of the time of a single step, and rounding stays below one grey level.
    """
    factor = 2**times
    height, width = (side // factor * factor for side in image.shape)
    reduced: GreyImage = np.ascontiguousarray(image[:height, :width])  # type: ignore[assignment]  # NumPy widens the dtype
    with single_threaded():
        for _ in range(times):
            height, width = height // 2, width // 2
            reduced = cv2.resize(reduced, (width, height), interpolation=cv2.INTER_AREA)
    return reduced


@contextmanager
def single_threaded() -> Iterator[None]:
    """Limit OpenCV to one thread: on small images its busy-waiting workers cost more than they save."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
