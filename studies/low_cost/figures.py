"""Names of the figures of an arm, as its run keeps them and the tables find them again."""

from __future__ import annotations

from enum import StrEnum
from typing import NamedTuple

SEPARATOR = "|"
NOMINAL_ERROR_KEY = "nominal error|mm"
REPEATABILITY_KEY = "repeatability|mm"


class CalibrationMethod(StrEnum):
    """Method of positioning."""

    OPEN = "open"  # method 1
    CLOSED = "closed"  # method 2


class DimensionSource(StrEnum):
    """Source of the Denavit-Hartenberg parameters."""

    NOMINAL = "nominal"
    FACTORY = "factory"


class Quantity(StrEnum):
    """Figure at a target."""

    ERROR_MM = "mm"
    ANGLE_DEG = "deg"
    ROUNDS = "rounds"
    SETTLED = "settled"


class Extent(StrEnum):
    """Summary of the absolute error of an arm."""

    MEAN = "mean"
    LARGEST = "max"


class Fit(StrEnum):
    """Figure of a calibration."""

    LOOKS = "looks"
    SCATTER_MM = "scatter mm"
    SCATTER_DEG = "scatter deg"
    HELD_OUT_MM = "held out mm"
    HELD_OUT_DEG = "held out deg"


class Place(NamedTuple):
    """Positioning at one target, with the number of its orientation."""

    method: CalibrationMethod
    dimensions: DimensionSource
    orientation: int
    target: int

    def key(self, quantity: Quantity) -> str:
        return SEPARATOR.join([*map(str, self), quantity])


def find_place(key: str, quantity: Quantity) -> Place | None:
    """Return the place at which a name is that of this figure; None for any other figure."""
    *place, last = key.split(SEPARATOR)
    if last != quantity or len(place) != len(Place._fields):
        return None
    method, dimensions, orientation, target = place
    return Place(CalibrationMethod(method), DimensionSource(dimensions), int(orientation), int(target))


def absolute_key(dimensions: DimensionSource, extent: Extent) -> str:
    return SEPARATOR.join(("absolute", dimensions, extent))


def fit_key(dimensions: DimensionSource, fit: Fit) -> str:
    return SEPARATOR.join(("calibration", dimensions, fit))
