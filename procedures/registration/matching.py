"""Correspondence of two unordered point sets with outliers in both: which point is which, or an honest no.

The largest sets of pairs with matching distances are fitted and scored; the best must be 10,000 times more
likely than any contradicting one, or the answer is AMBIGUOUS.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from procedures.registration.correspondence import Match, MatchStatus, Prior
from procedures.registration.errors import BadParameter, BadPoints
from procedures.registration.hypotheses import Noise
from procedures.registration.pairing_search import PairingSearch
from procedures.registration.points import FEWEST_PAIRS, checked_points

MOST_POINTS = 40  # a head carries up to ten; the graph grows with the square of both counts


def match(
    image_mm: ArrayLike,
    physical_mm: ArrayLike,
    *,
    sigma_image_mm: float,
    sigma_physical_mm: float,
    expected: int | None = None,
    prior: Prior | Rotation | None = None,
) -> Match:
    """Pair image points (n, 3) with physical points (m, 3), in mm, order unknown, outliers in both.

    The sigmas are one standard deviation per axis. `expected` is the planned number of pairs; UNIQUE then
    means exactly that many. `prior` is an approximate rotation physical <- image (bare: 60 degrees
    tolerance). Raises REG-001 and REG-007 (both ValueError); too few points is an answer, not an error.
    """
    image, physical = checked_points(image_mm, "image"), checked_points(physical_mm, "physical")
    for name, points in (("image", image), ("physical", physical)):
        if len(points) > MOST_POINTS:
            raise BadPoints(f"{len(points)} {name} points", limit=f"{MOST_POINTS} per set")
    noise = _noise(sigma_image_mm, sigma_physical_mm)
    _check_expected(expected)
    checked_prior = Prior(prior) if prior is not None and not isinstance(prior, Prior) else prior
    search = PairingSearch(image, physical, noise, expected, checked_prior)
    fewest = FEWEST_PAIRS if expected is None else expected
    if min(len(image), len(physical)) < fewest:
        return search.no_match(
            MatchStatus.TOO_FEW, f"{len(image)} image and {len(physical)} physical points, {fewest} needed"
        )
    return search.answer()


def _noise(sigma_image_mm: float, sigma_physical_mm: float) -> Noise:
    for name, sigma in (("image", sigma_image_mm), ("physical", sigma_physical_mm)):
        if not (isinstance(sigma, int | float | np.number) and math.isfinite(sigma) and sigma >= 0.0):
            raise BadParameter(f"sigma_{name}_mm must be a finite number, not negative", last=f"{sigma}")
    variance = float(sigma_image_mm) ** 2 + float(sigma_physical_mm) ** 2
    if variance <= 0.0:
        raise BadParameter("at least one sigma must be positive", last=f"{variance} mm2")
    return Noise(variance)


def _check_expected(expected: Any) -> None:
    if expected is None:
        return
    if isinstance(expected, bool) or not isinstance(expected, int | np.integer) or expected < FEWEST_PAIRS:
        raise BadParameter(f"expected must be a whole number of at least {FEWEST_PAIRS}", last=f"{expected}")
