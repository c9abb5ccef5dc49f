"""95 % confidence bounds on counts and means, to state uncertainty in the tables."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

CONFIDENCE = 0.95
ON_BOTH_SIDES = 0.5 * (1.0 + CONFIDENCE)
FISHER_LOST = 3  # degrees of freedom of his transformation of a correlation
CAPTION = f"{100 * CONFIDENCE:.0f} %"  # of the columns with bounds
NOTE = (
    f"{CAPTION}: bounds at this confidence, exact binomial (Clopper and Pearson) as for independent "
    "runs; one-sided where none or all were counted."
)


@dataclass(frozen=True)
class Bounded:
    """An estimate with bounds. `low` is None for a count of zero, `high` for a full count."""

    value: float
    low: float | None
    high: float | None

    @property
    def text(self) -> str:
        """Text such as `0.9 to 1.6`, `at most 0.3` or `at least 99.7`; empty without bounds."""
        if self.low is None:
            return "" if self.high is None else f"at most {self.high:.2g}"
        if self.high is None:
            return f"at least {self.low:.4g}"
        return f"{self.low:.3g} to {self.high:.3g}"


def column(of: str) -> str:
    """Return the heading of the column with another column's bounds."""
    return f"{of}, {CAPTION}"


def cells(name: str, estimate: Bounded, of: str = "") -> dict[str, float | str]:
    """Return the table cells for an estimate and its bounds. `of` is the column name without its unit."""
    return {name: estimate.value, column(of or name.rpartition(" ")[0] or name): estimate.text}


def percent(count: float, of: float) -> Bounded:
    """Return the percentage of independent runs; 0 without bounds if there were no runs."""
    number, runs = round(count), round(of)
    if not runs:
        return Bounded(0.0, None, None)
    side = "less" if number == 0 else "greater" if number == runs else "two-sided"
    from scipy.stats import binomtest  # half a second, not needed by campaign workers

    interval = binomtest(number, runs, alternative=side).proportion_ci(CONFIDENCE, "exact")
    return Bounded(
        100.0 * number / runs,
        None if number == 0 else 100.0 * float(interval.low),
        None if number == runs else 100.0 * float(interval.high),
    )


def share_by_group(
    counted: float, of: float, counted2: float, product: float, of2: float, groups: float
) -> Bounded | None:
    """Return the percentage of runs counted that come in independent groups, or None without runs.

    Given the sums over the groups of counts, runs, squares of both and products; bounds of a ratio by its
    linearized variance, with Student's t. Exact binomial ones, as for one run a group, where all or none
    count.
    """
    if not round(of):
        return None
    share = counted / of
    if groups < 2 or share in (0.0, 1.0):
        return replace(percent(share * groups, groups), value=100.0 * share)
    from scipy.stats import t

    squares = max(0.0, counted2 - 2.0 * share * product + share**2 * of2)
    spread = np.sqrt(squares * groups / (groups - 1.0)) / of
    half = float(t.ppf(ON_BOTH_SIDES, groups - 1.0) * spread)
    return Bounded(100.0 * share, 100.0 * max(0.0, share - half), 100.0 * min(1.0, share + half))


def number(count: float) -> Bounded:
    """Return the mean of a Poisson distribution from one observed count, with exact (Garwood) bounds."""
    from scipy.stats import chi2

    if not round(count):
        return Bounded(0.0, None, float(chi2.ppf(CONFIDENCE, 2)) / 2.0)
    low = float(chi2.ppf(1.0 - ON_BOTH_SIDES, 2 * round(count))) / 2.0
    return Bounded(float(count), low, float(chi2.ppf(ON_BOTH_SIDES, 2 * round(count) + 2)) / 2.0)


def mean(values: ArrayLike) -> Bounded:
    """Return the mean of independent values with Student's t bounds, or without for a single value."""
    array = np.asarray(values, dtype=float)
    value = float(array.mean())
    if len(array) < 2:
        return Bounded(value, None, None)
    from scipy.stats import t

    half = float(t.ppf(ON_BOTH_SIDES, len(array) - 1) * array.std(ddof=1) / np.sqrt(len(array)))
    return Bounded(value, value - half, value + half)


def mean_length(values: ArrayLike) -> Bounded:
    """Return the mean of lengths, with the lower bound clipped at 0."""
    bound = mean(values)
    return bound if bound.low is None else replace(bound, low=max(0.0, bound.low))


def root_mean_square(squares: float, fourths: float, runs: float) -> Bounded:
    """Return the rms of many independent values, from the sums of their squares and fourth powers."""
    square = squares / runs
    value = float(np.sqrt(square))
    if runs < 2:
        return Bounded(value, None, None)
    from scipy.stats import t

    spread = float(np.sqrt(max(0.0, fourths / runs - square**2) / (runs - 1)))
    half = float(t.ppf(ON_BOTH_SIDES, runs - 1)) * spread
    return Bounded(value, float(np.sqrt(max(0.0, square - half))), float(np.sqrt(square + half)))


def correlation(first: ArrayLike, second: ArrayLike) -> Bounded:
    """Return Pearson's correlation of independent pairs, with bounds by Fisher's transformation."""
    x, y = np.asarray(first, dtype=float), np.asarray(second, dtype=float)
    return correlation_of_sums(len(x), x.sum(), y.sum(), (x * x).sum(), (y * y).sum(), (x * y).sum())


def correlation_of_sums(
    count: float, first: float, second: float, first2: float, second2: float, product: float
) -> Bounded:
    """Return the correlation from sums over pairs: of both values, of their squares, and of their product."""
    spread = (first2 - first**2 / count) * (second2 - second**2 / count)
    value = float((product - first * second / count) / np.sqrt(spread)) if spread > 0.0 else 0.0
    if count <= FISHER_LOST:
        return Bounded(value, None, None)
    from scipy.stats import norm

    half = float(norm.ppf(ON_BOTH_SIDES)) / np.sqrt(count - FISHER_LOST)
    return Bounded(value, *(float(np.tanh(np.arctanh(value) + sign * half)) for sign in (-1.0, 1.0)))
