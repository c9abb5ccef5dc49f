"""Pairing of two unordered point sets with outliers in both, or an explanation of why none is certain.

The largest sets of pairs with matching distances are fitted and scored, each also with single pairs removed.
The best must be 10,000 times more likely than any that contradicts it, or the answer is AMBIGUOUS.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from procedures.registration.correspondence import Match, MatchStatus, PosePrior, Prior
from procedures.registration.errors import BAD_POINTS, BadParameter
from procedures.registration.pairings import (
    CLIQUE_SLACK,
    CliqueSearch,
    PairingCandidate,
    PairingEvidence,
    as_hypothesis,
    bits,
    consistency_graph,
    evaluate,
    gate,
)
from procedures.registration.points import FEWEST_PAIRS, validate_points
from ronna_hw.arguments import REAL_KINDS, show
from ronna_hw.arrays import Array

# Wide, because 8 fiducials have 28 distances, and one wrongly excluded splits the set into two that
# contradict each other. Five sigmas lose 2 runs of 1,000 when the length of an error is normal rather than
# each axis; the fit decides.
DISTANCE_GATE_SIGMAS = 7.0
UNIQUE_MARGIN_NATS = math.log(1e4)
DROPS_TRIED = 2  # a pairing that fails the gate is also judged with up to this many pairs removed

MOST_POINTS = 40  # a head carries up to ten; the graph grows with the product of both counts squared


def match(
    image_mm: ArrayLike,
    physical_mm: ArrayLike,
    *,
    sigma_image_mm: float | Sequence[float] | Array,
    sigma_physical_mm: float | Sequence[float] | Array,
    expected: int | None = None,
    prior: PosePrior | Rotation | None = None,
) -> Match:
    """Pair unordered image points (n, 3) with physical points (m, 3), in mm, with outliers in both.

    A sigma is one standard deviation, common to all axes or one per axis; pairing is isotropic and uses the
    rms of the three. `expected` is the planned number of pairs; UNIQUE then means exactly that many. `prior`
    is an approximate rotation physical <- image (bare: 60 degrees tolerance), or other evidence. Raises
    REG-001 and REG-007 (both ValueError); too few points are an answer, not an error.
    """
    image, physical = validate_points(image_mm, "image"), validate_points(physical_mm, "physical")
    for name, points in (("image", image), ("physical", physical)):
        if len(points) > MOST_POINTS:
            raise BAD_POINTS(f"{len(points)} {name} points", limit=f"{MOST_POINTS} per set")
    evidence = weigh_evidence(sigma_image_mm, sigma_physical_mm)
    _check_expected(expected)
    search = CorrespondenceSearch(image, physical, evidence, expected, validate_prior(prior))
    fewest, seen = expected or FEWEST_PAIRS, min(len(image), len(physical))
    counts = f"{len(image)} image and {len(physical)} physical points, {fewest} needed"
    if seen < FEWEST_PAIRS:
        return search.answer_without_pairs(MatchStatus.TOO_FEW, counts)
    if seen < fewest:
        return search.answer_too_few(counts)
    return search.answer()


def validate_prior(prior: PosePrior | Rotation | None) -> PosePrior | None:
    """Return the prior, giving a bare rotation the default tolerance. Raises REG-007."""
    return prior if prior is None or hasattr(prior, "objection") else Prior(prior)


def weigh_evidence(sigma_image_mm: Any, sigma_physical_mm: Any) -> PairingEvidence:
    """Build the evidence from the standard deviations given to `match`. Raises REG-007."""
    variance = _variance_mm2("image", sigma_image_mm) + _variance_mm2("physical", sigma_physical_mm)
    if variance <= 0.0:
        raise BadParameter(
            "at least one sigma must be positive", got=f"{variance} mm2", action="Give the larger one in mm."
        )
    return PairingEvidence(variance)


def _variance_mm2(name: str, sigma_mm: Any) -> float:
    """Return the variance per axis: a single sigma squared, or the mean square of three."""
    try:
        given = np.asarray(sigma_mm)
    except ValueError:  # rows of unequal length
        given = np.asarray(None)
    real = given.dtype.kind in REAL_KINDS and given.shape in ((), (3,))
    if not (real and np.all(np.isfinite(given)) and np.all(given >= 0)):
        raise BadParameter(
            f"sigma_{name}_mm is not a standard deviation",
            expected="one number or three (x, y, z), finite, not negative",
            got=show(sigma_mm),
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
            got=show(expected),
            action="Give the number of markers on the patient, or omit it.",
        )


@dataclass
class CorrespondenceSearch:
    """Search over two validated point sets in mm: cliques, fits, leave-one-out subsets, decision."""

    image: Array
    physical: Array
    evidence: PairingEvidence
    expected: int | None
    prior: PosePrior | None

    def answer(self) -> Match:
        """Search the largest cliques first, then all cliques if that does not settle the match."""
        tolerance_mm = DISTANCE_GATE_SIGMAS * math.sqrt(2.0 * self.evidence.variance_mm2)
        graph = consistency_graph(self.image, self.physical, tolerance_mm)
        nearest: list[PairingCandidate] = []
        is_outside_prior = False
        for slack in (CLIQUE_SLACK, len(graph)):
            search = CliqueSearch(graph, FEWEST_PAIRS, slack)
            cliques = search.run()
            if not cliques:
                break
            passing, failed = self._evaluate(cliques)
            allowed = [one for one in passing if not self._objection(one)]
            is_outside_prior = is_outside_prior or len(allowed) < len(passing)
            nearest = passing if is_outside_prior else failed or passing
            ranked = sorted(allowed, key=_score_key)
            if search.exhausted:
                return self._answer_too_noisy(ranked)
            best = min(passing, key=_score_key, default=None)
            if ranked and best and best.score_nats > ranked[0].score_nats + UNIQUE_MARGIN_NATS:
                return self._explain([best], True)  # some chance pairing is always allowed
            smallest_seen = max(FEWEST_PAIRS, search.largest - slack)
            unseen_nats = self.evidence.most_nats(smallest_seen - 1)
            is_all_seen = smallest_seen == FEWEST_PAIRS
            if ranked and (is_all_seen or ranked[0].score_nats - UNIQUE_MARGIN_NATS > unseen_nats):
                return self._judge(ranked, failed)
            if is_all_seen:
                break
        if not nearest:
            reason = f"no three points have matching distances within {tolerance_mm:.1f} mm"
            return self.answer_without_pairs(MatchStatus.INCONSISTENT, reason)
        return self._explain(nearest, is_outside_prior)

    def answer_too_few(self, counts: str) -> Match:
        """Return a result without pairs for too few points, reporting which of them agree."""
        found = self.answer()
        without_pairs = self.answer_without_pairs(MatchStatus.TOO_FEW, f"{counts}; {found.reason}")
        return replace(without_pairs, runner_up=found.runner_up)

    def _evaluate(self, cliques: list[int]) -> tuple[list[PairingCandidate], list[PairingCandidate]]:
        """Split candidates into passing and failed ones, dropping those with too little evidence."""
        masks_by_size: dict[int, list[int]] = {}
        for clique in cliques:
            masks_by_size.setdefault(clique.bit_count(), []).append(clique)
        passing: list[PairingCandidate] = []
        failed: list[PairingCandidate] = []
        best = -math.inf
        drops = dict.fromkeys(cliques, 0)
        for size in range(max(masks_by_size), FEWEST_PAIRS - 1, -1):
            if self.evidence.most_nats(size) < best - UNIQUE_MARGIN_NATS:
                break
            masks = list(dict.fromkeys(masks_by_size.get(size, ())))
            to_reduce: list[int] = []
            for one in evaluate(masks, self.image, self.physical, self.evidence):
                over_full = self.expected is not None and size == self.expected + 1
                if one.passed:
                    passing.append(one)
                    if not over_full and not self._objection(one):
                        best = max(best, one.score_nats)
                else:
                    failed.append(one)
                tries = 1 if best > -math.inf else DROPS_TRIED
                is_doubtful = not one.passed or self._may_have_bad_pair(one)
                if over_full or (is_doubtful and drops[one.nodes] < tries):
                    to_reduce.append(one.nodes)
            for parent in to_reduce if size > FEWEST_PAIRS else ():
                for node in bits(parent):  # dropping only the worst pair would leave swapped pairs behind
                    child = parent & ~(1 << node)
                    masks_by_size.setdefault(size - 1, []).append(child)
                    drops[child] = max(drops.get(child, 0), drops[parent] + 1)
        return passing, failed

    def _objection(self, one: PairingCandidate) -> str:
        """Explain why the prior excludes a candidate; return '' if it does not."""
        if self.prior is None:
            return ""
        paired = [node % len(self.physical) for node in bits(one.nodes)]
        return self.prior.objection(one.rotation, one.translation_mm, self.physical[paired])

    def _may_have_bad_pair(self, one: PairingCandidate) -> bool:
        """Whether a candidate may contain a bad pair that lowers its score, so that subsets must be tried.

        Up to the planned number of pairs none is doubted: they are known to exist.
        """
        planned = self.expected is not None and one.size <= self.expected
        return not planned and one.score_nats < self.evidence.most_nats(one.size - 1)

    def _judge(self, ranked: list[PairingCandidate], failed: list[PairingCandidate]) -> Match:
        """Decide whether the best candidate clearly beats all contradicting ones."""
        larger = [
            one for one in failed if one.size > max(FEWEST_PAIRS, ranked[0].size) and one.passed_mirrored
        ]
        if not larger and ranked[0].mirror_excess > 2.0 * UNIQUE_MARGIN_NATS:
            larger = ranked[:1]
        if larger:
            # Any three points of a mirrored set still fit; the whole set shows left and right swapped.
            return self.answer_without_pairs(MatchStatus.INCONSISTENT, _mirror_reason(larger[0]), larger[0])
        if self.expected is not None:
            # One pair too many is left to the leave-one-out subsets: one of them must clearly win.
            over_full = max(ranked, key=lambda one: one.size)
            ranked = [one for one in ranked if one.size <= self.expected]
            found = over_full if not ranked or over_full.size > self.expected + 1 else ranked[0]
            if found.size != self.expected:
                reason = f"{found.size} pairs agree, {self.expected} expected"
                return self.answer_without_pairs(MatchStatus.INCONSISTENT, reason, found)
        best = ranked[0]
        rivals = [one for one in ranked[1:] if one.nodes & ~best.nodes]
        if not rivals:
            # All smaller ones were skipped unseen; none of them can score more than this.
            unseen = self.evidence.most_nats(best.size - 1)
            return self._answer_unique(best, None, max(best.score_nats - unseen, UNIQUE_MARGIN_NATS))
        margin = best.score_nats - rivals[0].score_nats
        if margin < UNIQUE_MARGIN_NATS:
            reason = f"two pairings of {best.size} and {rivals[0].size} points fit nearly as well"
            return self._build_match(MatchStatus.AMBIGUOUS, reason, best, rivals[0], margin)
        return self._answer_unique(best, rivals[0], margin)

    def _answer_unique(self, best: PairingCandidate, rival: PairingCandidate | None, margin: float) -> Match:
        reason = f"{best.size} pairs agree, odds against any other pairing at least e^{margin:.0f}"
        return self._build_match(MatchStatus.UNIQUE, reason, best, rival, margin)

    def _answer_too_noisy(self, ranked: list[PairingCandidate]) -> Match:
        reason = "too many pairings agree within this noise; give a smaller sigma or fewer points"
        if not ranked:
            return self.answer_without_pairs(MatchStatus.AMBIGUOUS, reason)
        rivals = [one for one in ranked[1:] if one.nodes & ~ranked[0].nodes]
        rival = rivals[0] if rivals else None
        margin = ranked[0].score_nats - rival.score_nats if rival else 0.0
        return self._build_match(MatchStatus.AMBIGUOUS, reason, ranked[0], rival, margin)

    def _explain(self, nearest: list[PairingCandidate], is_outside_prior: bool) -> Match:
        """Explain, using the closest candidate, why no pairing passes."""
        excluded = [one for one in nearest if is_outside_prior and self._objection(one)]
        miss = max(excluded or nearest, key=lambda one: (one.size, one.score_nats))
        if is_outside_prior:
            objection = self._objection(miss)
            reason = f"the points agree only in an orientation that the prior excludes: {objection}"
        elif any(one.passed_mirrored for one in nearest if one.size == miss.size):
            reason = _mirror_reason(miss)
        elif miss.on_a_line:
            reason = f"the {miss.size} agreeing points are collinear and do not determine the rotation"
        else:
            reason = (
                f"{miss.size} pairs have matching distances but residuals beyond the noise"
                f" (chi-square {miss.chi_square:.0f}, limit {gate(miss.size):.0f})"
            )
        return self.answer_without_pairs(MatchStatus.INCONSISTENT, reason, miss)

    def answer_without_pairs(
        self, status: MatchStatus, reason: str, miss: PairingCandidate | None = None
    ) -> Match:
        """Return a result without pairs."""
        return self._build_match(status, reason, None, miss, 0.0)

    def _build_match(
        self,
        status: MatchStatus,
        reason: str,
        best: PairingCandidate | None,
        rival: PairingCandidate | None,
        margin: float,
    ) -> Match:
        paired, runner_up = (
            None if one is None else as_hypothesis(one, len(self.physical)) for one in (best, rival)
        )
        counts = len(self.image), len(self.physical)
        return Match.of(status, reason, paired, counts, runner_up=runner_up, margin_nats=margin)


def _mirror_reason(one: PairingCandidate) -> str:
    return f"{one.size} pairs agree only as a mirror image: check left and right of the series"


def _score_key(one: PairingCandidate) -> float:
    return -one.score_nats
