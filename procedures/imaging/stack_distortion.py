"""What the shape of the markers says of the stack of slices: its scale along the table, and a hidden tilt.

Markers are balls. A table that feeds more than the scanner states flattens all of them alike, and a gantry
that is tilted without a word shears them. One marker may be odd for reasons of its own; all of them are not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan, degrees, sqrt

import numpy as np

from procedures.imaging.errors import SlicesMisplaced
from procedures.imaging.markers import Marker
from ronna_hw.text import beyond

FEWEST = 4  # markers
SURE = 3.0  # standard errors
# Per unit of length: 1 % of scale leaves 0.24 mm rms at the markers after a rigid fit, 0.5 degrees of tilt
# 0.12 mm. Phantom volumes with neither reach 0.9 %, those of 3 mm slices and a sharp kernel; others 0.5 %.
WARNED = 0.009
REFUSED = 0.015


@dataclass(frozen=True)
class Distortion:
    """What markers have in common: `scale`, true over stated feed minus 1, and `shear`, mm per mm.

    Each comes with its standard error.
    """

    markers: int
    scale: float
    scale_error: float
    shear: float
    shear_error: float


def distortion_of(markers: Sequence[Marker], radius_mm: float) -> Distortion | None:
    """The medians over the markers of which enough shows; None with fewer than four of them."""
    shapes = [marker.shape_mm / radius_mm for marker in markers if marker.shape_mm is not None]
    if len(shapes) < FEWEST:
        return None
    along, down, across = np.array(shapes)[:, 0].T
    # the terms are free of a trace: what is longer than wide by a share has 2/3 of that along its axis
    scale, shears = -1.5 * along, 2.0 * np.stack((down, across))
    return Distortion(
        markers=len(shapes),
        scale=float(np.median(scale)),
        scale_error=float(scale.std(ddof=1)) / sqrt(len(shapes)),
        shear=float(np.linalg.norm(np.median(shears, axis=1))),
        shear_error=float(np.linalg.norm(shears.std(axis=1, ddof=1))) / sqrt(len(shapes)),
    )


def distortion_warnings(markers: Sequence[Marker], radius_mm: float) -> tuple[str, ...]:
    """Sentences on a distortion that is sure; raises CT-024 beyond 1.5 % of scale or 0.9 degrees of tilt."""
    found = distortion_of(markers, radius_mm)
    if found is None:
        return ()
    sentences = []
    if abs(found.scale) > max(WARNED, SURE * found.scale_error):
        more = "more" if found.scale > 0.0 else "less"
        said = f"the table seems to feed {{}} % {more} than the scanner states"
        sentences.append(_sentence(said, 1e2 * abs(found.scale), 1e2 * REFUSED, "%", found.markers))
    if found.shear > max(WARNED, SURE * found.shear_error):
        said = "the slices seem to be tilted by {} degrees, which the scanner does not state"
        tilt_deg, limit_deg = degrees(atan(found.shear)), degrees(atan(REFUSED))
        sentences.append(_sentence(said, tilt_deg, limit_deg, "degrees", found.markers))
    return tuple(sentences)


def _sentence(said: str, value: float, limit: float, unit: str, markers: int) -> str:
    """The sentence; raises CT-024 beyond the limit."""
    if value > limit:
        raise SlicesMisplaced(
            f"by the shape of {markers} markers {said.format(beyond(value, limit, 1))}",
            limit=f"{limit:.1f} {unit}",
        )
    return f"by the shape of {markers} markers {said.format(f'{value:.1f}')}"
