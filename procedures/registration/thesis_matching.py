"""The thesis' matcher for one pairing: its similarity matrix, validated against the stated errors.

The thesis says that the known errors of both sets validate a successful pairing (5.3), but not how. Here the
pairs are fitted, and the sum of squared residuals must not exceed what the stated standard deviations
explain.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from procedures.registration.correspondence import Hypothesis, Match, MatchStatus, PosePrior
from procedures.registration.matching import weigh_evidence
from procedures.registration.pairings import LINE_RATIO, gate
from procedures.registration.points import FEWEST_PAIRS, validate_points
from procedures.registration.rigid_fit import as_transform, fit_rigid, residuals
from procedures.registration.similarity_matrix import SimilarityPairs, match_many_by_similarity, no_pairs
from procedures.registration.thesis_settings import REFUSED_SHARE, check_thesis_settings
from ronna_hw.arrays import Array


def validate_many(
    image_mm: Array,
    physical_mm: Array,
    found: Sequence[SimilarityPairs],
    variance_mm2: float,
    refused_share: float = REFUSED_SHARE,
) -> tuple[SimilarityPairs, ...]:
    """Check pairings of image (b, n, 3) and physical points (b, m, 3), mm, against the stated errors.

    `variance_mm2` is the stated variance per axis of both sets together. A UNIQUE pairing whose residuals
    are larger than those of all but `refused_share` of the correct ones becomes INCONSISTENT; the others are
    returned unchanged.
    """
    by_size: dict[int, list[int]] = {}
    for number, one in enumerate(found):
        if one.status is MatchStatus.UNIQUE:
            by_size.setdefault(len(one.pairs), []).append(number)
    judged = list(found)
    for size, numbers in by_size.items():
        pairs = np.array([found[number].pairs for number in numbers])
        image = np.take_along_axis(image_mm[numbers], pairs[:, :, :1], axis=1)
        physical = np.take_along_axis(physical_mm[numbers], pairs[:, :, 1:], axis=1)
        rest = residuals(fit_rigid(image, physical), image, physical)
        too_large = np.square(rest).sum(axis=(1, 2)) > gate(size, refused_share) * variance_mm2
        for number in np.array(numbers)[too_large].tolist():
            judged[number] = no_pairs(MatchStatus.INCONSISTENT)
    return tuple(judged)


def match_as_thesis(
    image_mm: ArrayLike,
    physical_mm: ArrayLike,
    *,
    e_mm: float,
    sigma_image_mm: float,
    sigma_physical_mm: float,
    refused_share: float,
    expected: int | None = None,
    prior: PosePrior | None = None,
) -> Match:
    """Pair image points (n, 3) with physical points (m, 3), in mm, in the form of `match`.

    The method counts matching distances. It weighs no rival pairing, so it states no odds: `margin_nats` and
    the score are None. It must know the number of markers: without `expected` it is the largest that gives a
    pairing. The patient's position can only refuse a pairing. Raises REG-001 and REG-007.
    """
    image, physical = validate_points(image_mm, "image"), validate_points(physical_mm, "physical")
    variance_mm2 = weigh_evidence(sigma_image_mm, sigma_physical_mm).variance_mm2
    check_thesis_settings(e_mm, refused_share)
    counts = len(image), len(physical)
    fewest = expected or FEWEST_PAIRS
    if min(counts) < fewest:
        sizes = f"{counts[0]} image and {counts[1]} physical points, {fewest} needed"
        return Match.of(MatchStatus.TOO_FEW, sizes, None, counts, margin_nats=None)
    stacked = image[None], physical[None]
    for markers in (expected,) if expected else range(min(counts), FEWEST_PAIRS - 1, -1):
        (raw,) = match_many_by_similarity(*stacked, np.array([e_mm]), markers)
        if raw.status is MatchStatus.UNIQUE:
            break
    (found,) = validate_many(*stacked, [raw], variance_mm2, refused_share)
    if found.status is not MatchStatus.UNIQUE:
        return Match.of(found.status, _explain(raw, markers, e_mm), None, counts, margin_nats=None)
    pairs = found.pairs
    of_image, of_physical = image[pairs[:, 0]], physical[pairs[:, 1]]
    fit = fit_rigid(of_image, of_physical)
    objection = ""
    if fit.spread_mm2[1] <= LINE_RATIO * fit.spread_mm2[0]:
        objection = f"the {len(pairs)} agreeing points are collinear and do not determine the rotation"
    elif prior is not None and (why := prior.objection(fit.rotation, fit.translation_mm, of_physical)):
        objection = f"the points agree only in an orientation that the prior excludes: {why}"
    hypothesis = Hypothesis(
        pairs,
        as_transform(fit.rotation, fit.translation_mm),
        float(np.square(residuals(fit, of_image, of_physical)).sum()) / variance_mm2,
        gate(len(pairs), refused_share),
        None,
    )
    if objection:
        return Match.of(
            MatchStatus.INCONSISTENT, objection, None, counts, runner_up=hypothesis, margin_nats=None
        )
    reason = f"{len(pairs)} pairs agree within e = {e_mm:g} mm"
    return Match.of(MatchStatus.UNIQUE, reason, hypothesis, counts, margin_nats=None)


def _explain(raw: SimilarityPairs, markers: int, e_mm: float) -> str:
    if raw.status is MatchStatus.UNIQUE:
        return f"{markers} pairs agree within e = {e_mm:g} mm, but with residuals beyond the noise"
    if raw.status is MatchStatus.AMBIGUOUS:
        return f"within e = {e_mm:g} mm more than {markers} spheres agree, or some with more than one partner"
    return f"fewer than {markers} spheres have distances to the others that match within e = {e_mm:g} mm"
