"""Evidence that some points of a scan are displaced together: a look after a movement.

The residuals are explained with and without a further displacement of unknown size, under the same hypotheses
about the misfit. The ratio of the likelihoods (Bayes factor) says which is more likely, and it takes a misfit
that happens to look like a displacement into account.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve
from scipy.special import logsumexp

from procedures.registration.surface.misfit import MisfitModel
from ronna_hw.arrays import Array


@dataclass(frozen=True, eq=False)
class Displacement:
    """Log Bayes factor for a displacement, and its likeliest size (k,) in units of the columns."""

    log_evidence: float
    size: Array


def weigh_displacements(
    model: MisfitModel, jacobian: Array, residuals_mm: Array, columns: Sequence[Array]
) -> list[Displacement]:
    """Weigh displacements, each given as columns (n, k): the residuals by one standard deviation of it."""
    if not columns:
        return []
    ends = np.cumsum([0, *(one.shape[1] for one in columns)])
    both = np.column_stack([jacobian, residuals_mm, *columns])
    pose = jacobian.shape[1]
    logs, with_it, sizes = [], [], []
    for (factor, is_lower), determinant in zip(model.factors, model.log_determinants, strict=True):
        weighted = cho_solve((factor, is_lower), both, check_finite=False)
        product = both.T @ weighted
        inner = product[:pose, :pose]
        left = product - product[:, :pose] @ np.linalg.solve(inner, product[:pose])  # the pose taken out
        logs.append(-0.5 * (determinant + left[pose, pose] + np.linalg.slogdet(inner)[1]))
        gains, found = [], []
        for start, end in zip(ends[:-1] + pose + 1, ends[1:] + pose + 1, strict=True):
            precision = np.eye(end - start) + left[start:end, start:end]
            projected = left[start:end, pose]
            size = np.linalg.solve(precision, projected)
            gains.append(0.5 * (projected @ size - np.linalg.slogdet(precision)[1]))
            found.append(size)
        with_it.append(gains)
        sizes.append(found)
    without = np.array(logs)
    total = without[:, None] + np.array(with_it)
    evidence = logsumexp(total, axis=0) - logsumexp(without)
    best = total.argmax(axis=0)
    return [
        Displacement(float(evidence[number]), sizes[best[number]][number]) for number in range(len(columns))
    ]
