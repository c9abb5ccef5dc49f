"""Measures a retro-reflective sphere in one image: centre, semi-axes, quality.

Reduces the image, guesses circles from edges, then refines and judges them on the full image, best first.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from procedures.relocalization.circle_search import Circle, find_circles
from procedures.relocalization.errors import BadImage, NoContrast, NoSphere, Saturated
from procedures.relocalization.opencv_edges import GreyImage, find_edges, halved
from procedures.relocalization.outline import refined
from procedures.relocalization.sphere_image import SphereImage, SphereStatus

REDUCED_PIXELS = 150_000  # at most, of the image in which circles are sought: a quarter of the sensor's sides
SMALLEST_SIDE_PX = 48
TWELVE_BIT_LIMIT = 4095
SMALLEST_RADIUS_PX = 8.0  # px of the reduced image: with less, the rim has too few pixels to judge
DARK_PERCENTILE = 2.0
BRIGHT_PERCENTILE = 99.8
CONTRAST_FLOOR = 0.02  # of the grey range; with less it is noise or a uniform field
SATURATED_LEVEL, DARK_LEVEL = 0.95, 0.15  # of the grey range, of an image without contrast


def measure_sphere(
    image: NDArray[np.uint8] | NDArray[np.uint16],
    *,
    radius_range_px: tuple[float, float] | None = None,
) -> SphereImage:
    """The bright sphere with the most visible rim in a 2-D uint8 or uint16 (12-bit) image, left unmodified.

    Any byte order is accepted. `radius_range_px` excludes discs of another size when the size is known.
    Raises STE-001 for any other input, STE-002 without contrast, STE-011 when fully saturated, STE-003 when
    no sphere is in view. A sphere with too little visible rim is returned as UNRELIABLE.
    """
    best: SphereImage | None = None
    round_shapes = 0
    for sphere in _spheres(image, radius_range_px):
        round_shapes += 1
        if sphere is None:
            continue
        if sphere.status is SphereStatus.OK:
            return sphere
        if best is None or _visible_px(sphere) > _visible_px(best):
            best = sphere
    if best is None:
        raise NoSphere(
            "no sphere in view",
            expected="a bright disc",
            got=f"{round_shapes} round shape(s), none of them a sphere",
        )
    return best


def measure_spheres(
    image: NDArray[np.uint8] | NDArray[np.uint16],
    *,
    radius_range_px: tuple[float, float] | None = None,
) -> tuple[SphereImage, ...]:
    """Every distinct disc in the image that may be a sphere, most visible rim first.

    Like `measure_sphere`, except that finding none is not an error.
    """
    return tuple(sphere for sphere in _spheres(image, radius_range_px) if sphere is not None)


def _spheres(
    image: NDArray[np.uint8] | NDArray[np.uint16], radius_range_px: tuple[float, float] | None
) -> Iterator[SphereImage | None]:
    """Each round shape, measured lazily; None if it is not a disc."""
    grey = _checked(image)
    halvings = max(0, math.ceil(0.5 * math.log2(grey.size / REDUCED_PIXELS)))
    factor, reduced = 2**halvings, halved(grey, halvings)
    dark, bright = (
        float(value) for value in np.percentile(reduced[::2, ::2], (DARK_PERCENTILE, BRIGHT_PERCENTILE))
    )
    full_range = 255.0 if grey.dtype == np.uint8 else float(TWELVE_BIT_LIMIT)
    if bright - dark < CONTRAST_FLOOR * full_range:
        _refuse_even(dark, bright, full_range)
    low, high = radius_range_px or (SMALLEST_RADIUS_PX * factor, 0.75 * max(grey.shape))
    guesses = find_circles(find_edges(reduced, dark, bright), 0.95 * low / factor, 1.05 * high / factor)
    for guess in guesses:  # most visible rim first
        sphere = refined(grey, _enlarged(guess, factor), factor)
        in_range = sphere is not None and low <= math.sqrt(math.prod(sphere.axes_px)) <= high
        yield sphere if in_range else None


def _refuse_even(dark: float, bright: float, full_range: float) -> NoReturn:
    limit, last = f"{CONTRAST_FLOOR * full_range:.0f} grey values apart", f"{dark:.0f} to {bright:.0f}"
    if dark >= SATURATED_LEVEL * full_range:
        raise Saturated("the image is saturated", limit=limit, got=last)
    evenness = "completely dark" if bright <= DARK_LEVEL * full_range else "uniform: it has no contrast"
    raise NoContrast(f"the image is {evenness}", limit=limit, got=last)


def _visible_px(sphere: SphereImage) -> float:
    return sphere.rim_fraction * sphere.axes_px[0]


def _checked(image: object) -> GreyImage:
    if not isinstance(image, np.ndarray):
        raise BadImage("the image is not an array", got=type(image).__name__)
    native = image.dtype.newbyteorder("=")
    if image.ndim != 2 or native not in (np.dtype(np.uint8), np.dtype(np.uint16)):
        raise BadImage("the image is not a greyscale image", got=f"{image.ndim}-D {image.dtype}")
    if min(image.shape) < SMALLEST_SIDE_PX:
        raise BadImage("the image is too small", limit=f"{SMALLEST_SIDE_PX} px", got=str(image.shape))
    if native == np.uint16 and int(image.max()) > TWELVE_BIT_LIMIT:
        raise BadImage(
            "the image has values of more than 12 bits", limit=str(TWELVE_BIT_LIMIT), got=str(image.max())
        )
    return image.astype(native, copy=False)  # OpenCV accepts only the byte order of this machine


def _enlarged(guess: Circle, factor: int) -> Circle:
    x, y = (factor * (value + 0.5) - 0.5 for value in guess.centre_px)
    return Circle((x, y), factor * guess.radius_px, guess.coverage)
