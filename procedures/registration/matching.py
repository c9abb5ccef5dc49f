"""Correspondence of two unordered point sets with outliers in both, or the reason why none was found.

The largest sets of pairs with matching distances are fitted and scored; the best must be 10,000 times more
likely than any contradicting one, or the answer is AMBIGUOUS.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from procedures.registration.correspondence import Match, MatchStatus, PosePrior, Prior
from procedures.registration.correspondence_search import CorrespondenceSearch
from procedures.registration.errors import BadParameter, BadPoints
from procedures.registration.hypotheses import Evidence
from procedures.registration.points import FEWEST_PAIRS, REAL_KINDS, checked_points

MOST_POINTS = 40  # a head carries up to ten; the graph grows with the product of both counts squared


def match(
    image_mm: ArrayLike,
    physical_mm: ArrayLike,
    *,
    sigma_image_mm: float | Sequence[float] | NDArray[np.float64],
    sigma_physical_mm: float | Sequence[float] | NDArray[np.float64],
    expected: int | None = None,
    prior: PosePrior | Rotation | None = None,
) -> Match:
    """Pair image points (n, 3) with physical points (m, 3), in mm, order unknown, outliers in both.

    A sigma is one standard deviation, common to all axes or one per axis; pairing is isotropic and uses the
    rms of the three. `expected` is the planned number of pairs; UNIQUE then means exactly that many. `prior`
    is an approximate rotation physical <- image (bare: 60 degrees tolerance), or other evidence. Raises
    REG-001 and REG-007 (both ValueError); too few points are an answer, not an error.
    """
    image, physical = checked_points(image_mm, "image"), checked_points(physical_mm, "physical")
    for name, points in (("image", image), ("physical", physical)):
        if len(points) > MOST_POINTS:
            raise BadPoints(f"{len(points)} {name} points", limit=f"{MOST_POINTS} per set")
    evidence = evidence_of(sigma_image_mm, sigma_physical_mm)
    _check_expected(expected)
    search = CorrespondenceSearch(image, physical, evidence, expected, checked_prior(prior))
    fewest, seen = expected or FEWEST_PAIRS, min(len(image), len(physical))
    counts = f"{len(image)} image and {len(physical)} physical points, {fewest} needed"
    if seen < FEWEST_PAIRS:
        return search.no_match(MatchStatus.TOO_FEW, counts)
    if seen < fewest:
        return search.too_few(counts)
    return search.answer()


def checked_prior(prior: PosePrior | Rotation | None) -> PosePrior | None:
    """The prior as given to `match`, a bare rotation with the default tolerance. Raises REG-007."""
    return prior if prior is None or hasattr(prior, "objection") else Prior(prior)


def evidence_of(sigma_image_mm: Any, sigma_physical_mm: Any) -> Evidence:
    """The weight of evidence for these standard deviations, given as to `match`. Raises REG-007."""
    variance = _variance_mm2("image", sigma_image_mm) + _variance_mm2("physical", sigma_physical_mm)
    if variance <= 0.0:
        raise BadParameter(
            "at least one sigma must be positive", got=f"{variance} mm2", action="Give the larger one in mm."
        )
    return Evidence(variance)


def _variance_mm2(name: str, sigma_mm: Any) -> float:
    """Variance per axis: the square of one number, or the mean square of three."""
    try:
        given = np.asarray(sigma_mm)
    except ValueError:  # rows of unequal length
        given = np.asarray(None)
    real = given.dtype.kind in REAL_KINDS and given.shape in ((), (3,))
    if not (real and np.all(np.isfinite(given)) and np.all(given >= 0)):
        raise BadParameter(
            f"sigma_{name}_mm is not a standard deviation",
            expected="one number or three (x, y, z), finite, not negative",
            got=" ".join(str(sigma_mm).split()),
            action="Give standard deviations per axis in mm.",
        )
    squares = [float(one) ** 2 for one in given.ravel()]
    return sum(squares) / len(squares)


def _check_expected(expected: Any) -> None:
    if expected is None:
        return
    if isinstance(expected, bool) or not isinstance(expected, int | np.integer) or expected < FEWEST_PAIRS:
        raise BadParameter(
            f"expected must be a whole number of at least {FEWEST_PAIRS}",
            got=f"{expected}",
            action="Give the number of markers on the patient, or omit it.",
        )
