"""Scoring of candidate pairings: rigid fit, chi-square gate, Bayesian score.

All candidates of one size are fitted as one stack. Scores are log odds (nats) against "all of these are
unrelated points": residuals cost q/2; every pair beyond the second earns the negative logarithm of the
probability of an accidental match within the noise. Two things are assumed a priori: most points are spheres
that both sides see, not strays; and the spheres are on one head.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from procedures.registration.consistency_graph import bits
from procedures.registration.correspondence import Hypothesis
from procedures.registration.rigid_fit import as_transform, fit_rigid, mirrored_sum_mm2, residuals

Array = NDArray[np.float64]

GATE_FALSE_ALARM = 1e-6  # probability that the gate rejects correct pairs
OUTLIER_BALL_RADIUS_MM = 300.0  # stray markers are within this ball around the head
LN_OUTLIER_VOLUME = math.log(4.0 / 3.0 * math.pi * OUTLIER_BALL_RADIUS_MM**3)
# Assumed, not measured: decision 10 shows how the answers depend on these odds.
PAIR_ODDS = 10.0  # a priori, that two points which could be the same sphere are
WIDE_SET_ODDS = 1e-3  # that pairs farther apart than a head is wide are all correct
WIDEST_HEAD_MM = 260.0  # between two spheres: a head 220 mm long, plus a base and half a sphere at each end
LINE_RATIO = 1e-3  # second over first singular value; below it a set is a line and fixes no rotation


@dataclass(frozen=True)
class Evidence:
    """The weight of evidence, from the variance per axis of both sets together, mm2."""

    variance_mm2: float

    @property
    def nats_per_pair(self) -> float:
        """What each additional agreeing pair is worth."""
        by_chance = LN_OUTLIER_VOLUME - 1.5 * math.log(2.0 * math.pi * self.variance_mm2)
        return math.log(PAIR_ODDS) + by_chance

    def most_nats(self, pairs: int) -> float:
        """Upper bound on the score of a candidate of this size."""
        return (pairs - 2) * self.nats_per_pair


@lru_cache(maxsize=64)
def gate(pairs: int, false_alarm: float = GATE_FALSE_ALARM) -> float:
    """Limit on the residual chi-square of a rigid fit of this many pairs, valid for both noise models.

    If an error is normal on each axis, the residual is chi-square with 3k - 6 degrees of freedom. If its
    length is normal, in any direction, the variance is the same but the tail is longer: three times a
    chi-square with one degree per point, of which the fit takes 6 parts in 3k.
    """
    per_axis = float(chdtri(3 * pairs - 6, false_alarm))
    by_length = (3.0 - 6.0 / pairs) * float(chdtri(pairs, false_alarm))
    return max(per_axis, by_length)


@dataclass(frozen=True)
class Candidate:
    """One pairing after its fit. `nodes` is a bit mask; `chi_square` the residual sum over the variance."""

    nodes: int
    size: int
    chi_square: float
    mirrored_chi_square: float
    score_nats: float
    rotation: Array
    translation_mm: Array
    on_a_line: bool

    @property
    def passed(self) -> bool:
        """Whether noise explains the residuals and the points determine a rotation."""
        return self.chi_square < gate(self.size) and not self.on_a_line

    @property
    def mirror_excess(self) -> float:
        """How much chi-square a mirror image would save; negative if the rotation fits better."""
        return self.chi_square - self.mirrored_chi_square

    @property
    def passed_mirrored(self) -> bool:
        """Whether a mirror image would pass where this rotation does not."""
        return not self.passed and not self.on_a_line and self.mirrored_chi_square < gate(self.size)


def evaluate(
    masks: Sequence[int], image_mm: Array, physical_mm: Array, evidence: Evidence
) -> list[Candidate]:
    """Fit and score pairings that all have the same number of pairs."""
    if not masks:
        return []
    nodes = np.array([bits(mask) for mask in masks])
    size = nodes.shape[1]
    image, physical = image_mm[nodes // len(physical_mm)], physical_mm[nodes % len(physical_mm)]
    fit = fit_rigid(image, physical)
    squares = np.square(residuals(fit, image, physical)).sum(axis=(1, 2))
    chi_squares = squares / evidence.variance_mm2
    mirrored = mirrored_sum_mm2(fit, squares) / evidence.variance_mm2
    widths_mm = np.linalg.norm(image[:, :, None] - image[:, None], axis=-1).max(axis=(1, 2))
    known_nats = np.where(widths_mm > WIDEST_HEAD_MM, math.log(WIDE_SET_ODDS), 0.0)
    scores = evidence.most_nats(size) + known_nats - 0.5 * chi_squares
    on_a_line = fit.spread_mm2[:, 1] <= LINE_RATIO * fit.spread_mm2[:, 0]
    return [
        Candidate(
            mask,
            size,
            float(chi_squares[row]),
            float(mirrored[row]),
            float(scores[row]),
            fit.rotation[row],
            fit.translation_mm[row],
            bool(on_a_line[row]),
        )
        for row, mask in enumerate(masks)
    ]


def leave_one_out(masks: Sequence[int]) -> list[int]:
    """All pairings with one pair dropped, without repeats.

    Dropping only the worst pair would leave swapped pairs behind.
    """
    return list(dict.fromkeys(mask & ~(1 << node) for mask in masks for node in bits(mask)))


def as_hypothesis(one: Candidate, physical_count: int) -> Hypothesis:
    """A candidate as reported: pairs of indices, transform and score."""
    pairs = np.stack(np.divmod(np.array(bits(one.nodes), dtype=np.intp), physical_count), axis=1)
    transform = as_transform(one.rotation, one.translation_mm)
    return Hypothesis(pairs, transform, one.chi_square, gate(one.size), one.score_nats)
