"""Straight streaks across the markers of a scan."""

from __future__ import annotations

from math import cos, pi, sin

import numpy as np

from sim.phantom.families.catalogue import MarkerBands
from sim.phantom.head.anatomy import Marker, shifted
from sim.phantom.head.streaks import Band

PASSING_MM = 40.0  # half the length of a band that passes a sphere
RAY_MM = 25.0  # and of one that starts at metal


def draw_bands(
    kind: MarkerBands | None, markers: tuple[Marker, ...], generator: np.random.Generator
) -> tuple[Band, ...]:
    """Some for each marker; none if the family has none."""
    if kind is None:
        return ()
    return tuple(
        _band(kind, marker, generator)
        for marker in markers
        for _ in range(int(generator.integers(kind.count[0], kind.count[1] + 1)))
    )


def _band(kind: MarkerBands, marker: Marker, generator: np.random.Generator) -> Band:
    angle = float(generator.uniform(0.0, 2.0 * pi))
    sign = float(generator.choice((-1.0, 1.0)))
    below = float(generator.uniform(*kind.below_mm))
    beside = float(generator.uniform(*kind.beside_mm))
    fiducial = marker.fiducial
    if kind.from_metal:
        middle = shifted(fiducial.centre_ct_mm, fiducial.post_ct, -below)
        middle = shifted(middle, (cos(angle), sin(angle), 0.0), RAY_MM)
    else:
        middle = shifted(fiducial.centre_ct_mm, (0.0, 0.0, -1.0), below)
    return Band(
        shifted(middle, (-sin(angle), cos(angle), 0.0), beside),
        sign * float(generator.uniform(*kind.hu)),
        angle,
        float(generator.uniform(*kind.width_mm)),
        float(generator.uniform(*kind.height_mm)),
        RAY_MM if kind.from_metal else PASSING_MM,
    )
