"""One pairing by the similarity matrix of the thesis, in the form of `match`. Not for clinical use.

The method counts matching distances. It weighs no rival pairing, so it states no odds, and it knows neither
the number of markers nor the patient's position: with those its pairing can only be refused.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from procedures.registration.correspondence import Hypothesis, Match, MatchStatus, PosePrior
from procedures.registration.matching import weigh_evidence
from procedures.registration.pairings import LINE_RATIO, gate
from procedures.registration.points import FEWEST_PAIRS, validate_points
from procedures.registration.rigid_fit import as_transform, fit_rigid, residuals
from procedures.registration.similarity_matrix import SimilarityPairs, match_many_by_similarity, validate_many
from procedures.registration.thesis_settings import check_thesis_settings


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
    """Pair image points (n, 3) with physical points (m, 3), in mm; other arguments as for `match`.

    `margin_nats` and the score are None. Raises REG-001 and REG-007.
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
    (raw,) = match_many_by_similarity(*stacked, np.array([e_mm]))
    (found,) = validate_many(*stacked, [raw], variance_mm2, refused_share)
    if found.status is not MatchStatus.UNIQUE:
        return Match.of(found.status, _explain(raw, e_mm), None, counts, margin_nats=None)
    pairs = found.pairs[np.argsort(found.pairs[:, 0])]
    of_image, of_physical = image[pairs[:, 0]], physical[pairs[:, 1]]
    fit = fit_rigid(of_image, of_physical)
    objection = ""
    if expected is not None and len(pairs) != expected:
        objection = f"{len(pairs)} pairs agree, {expected} expected"
    elif fit.spread_mm2[1] <= LINE_RATIO * fit.spread_mm2[0]:
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


def _explain(raw: SimilarityPairs, e_mm: float) -> str:
    if raw.status is MatchStatus.UNIQUE:
        return f"{len(raw.pairs)} pairs agree within e = {e_mm:g} mm, but with residuals beyond the noise"
    if raw.status is MatchStatus.AMBIGUOUS:
        return f"within e = {e_mm:g} mm some spheres have more than one partner"
    return f"no three points have matching distances within e = {e_mm:g} mm"
