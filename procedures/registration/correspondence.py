"""Correspondence of two point sets, its certainty, and prior knowledge of the orientation."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import Protocol, Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.registration.errors import NO_UNIQUE_MATCH, BadParameter
from ronna_hw.arrays import Array

DEFAULT_PRIOR_TOLERANCE_RAD = math.radians(60.0)  # enough to distinguish supine, prone and lateral


class MatchStatus(StrEnum):
    """Certainty of a correspondence; only UNIQUE permits motion."""

    UNIQUE = "UNIQUE"
    AMBIGUOUS = "AMBIGUOUS"
    TOO_FEW = "TOO_FEW"
    INCONSISTENT = "INCONSISTENT"


class PosePrior(Protocol):
    """Evidence about the pose physical <- image, independent of inter-point distances."""

    def objection(self, rotation: Array, translation_mm: Array, physical_mm: Array) -> str:
        """Explain why a pose, (3, 3) and (3,), of paired points (k, 3) is unlikely; '' if it is not."""
        ...


@dataclass(frozen=True)
class Prior:
    """Approximate rotation physical <- image, and how far the true rotation may deviate from it."""

    rotation: Rotation
    tolerance_rad: float = DEFAULT_PRIOR_TOLERANCE_RAD

    def __post_init__(self) -> None:
        """Raise REG-007 unless the prior is a single rotation with a tolerance of at most pi."""
        if not isinstance(self.rotation, Rotation) or np.shape(self.rotation.as_quat()) != (4,):
            raise BadParameter(
                "a prior needs one SciPy Rotation physical <- image",
                got=type(self.rotation).__name__,
                action="Give one, such as Rotation.from_matrix(turn).",
            )
        if not (isinstance(self.tolerance_rad, int | float) and 0.0 < self.tolerance_rad <= math.pi):
            raise BadParameter(
                "the prior's tolerance is out of range",
                limit="0 to pi rad",
                got=f"{self.tolerance_rad}",
                action="Give an angle in radians: math.radians(degrees).",
            )

    def objection(self, rotation: Array, translation_mm: Array, physical_mm: Array) -> str:
        """State how far the rotation is off if it exceeds the tolerance; return '' otherwise."""
        turned_rad = turn_rad(np.asarray(self.rotation.as_matrix(), dtype=float), rotation)
        if turned_rad <= self.tolerance_rad:
            return ""
        limit_deg = math.degrees(self.tolerance_rad)
        return f"{math.degrees(turned_rad):.0f} deg from the expected orientation, limit {limit_deg:.0f} deg"


def turn_rad(one: Array, other: Array) -> float:
    """Return the angle between two rotations (3, 3), in rad."""
    cosine = 0.5 * (float(np.vdot(one, other)) - 1.0)  # the trace of one^T other
    return math.acos(min(1.0, max(-1.0, cosine)))


@dataclass(frozen=True)
class Hypothesis:
    """Possible correspondence: `pairs` (k, 2) of image and physical indices, with transform and score.

    The score is None from a matcher that states no odds.
    """

    pairs: NDArray[np.intp]
    transform: RigidTransform
    chi_square: float
    chi_square_limit: float
    score_nats: float | None


@dataclass(frozen=True)
class Match:
    """Result of `match`.

    UNIQUE: `pairs` (k, 2) image and physical indices, ordered by image index, and `transform` physical <-
    image; `runner_up` is the best contradicting hypothesis, if one came close. AMBIGUOUS: the best hypothesis
    in `pairs` and `transform`, for display only, and its rival in `runner_up`. TOO_FEW and INCONSISTENT: no
    pairs, no transform; `runner_up` is the nearest miss, None if no three points agree. `margin_nats` is a
    lower bound on the log odds of the best against its rival, None from a matcher that states no odds.
    """

    status: MatchStatus
    pairs: NDArray[np.intp]
    transform: RigidTransform | None
    reason: str
    runner_up: Hypothesis | None
    margin_nats: float | None
    unmatched_image: tuple[int, ...]
    unmatched_physical: tuple[int, ...]

    @classmethod
    def of(
        cls,
        status: MatchStatus,
        reason: str,
        best: Hypothesis | None,
        counts: tuple[int, int],
        *,
        runner_up: Hypothesis | None = None,
        margin_nats: float | None = 0.0,
    ) -> Self:
        """Build the result from the best hypothesis, if any; `counts` are the image and physical points."""
        pairs = np.zeros((0, 2), dtype=np.intp) if best is None else best.pairs
        unmatched = [
            tuple(index for index in range(count) if index not in set(used.tolist()))
            for count, used in zip(counts, pairs.T, strict=True)
        ]
        return cls(status, pairs, best and best.transform, reason, runner_up, margin_nats, *unmatched)

    def require_unique(self) -> RigidTransform:
        """Return the transform. Raise REG-008 with the closest hypotheses unless the match is unique."""
        if self.status is not MatchStatus.UNIQUE or self.transform is None:
            nearest = [_format_pairs(self.pairs)] if len(self.pairs) else []
            nearest += [_format_pairs(self.runner_up.pairs)] if self.runner_up else []
            raise NO_UNIQUE_MATCH(
                f"the correspondence is {self.status}: {self.reason}", got=", or ".join(nearest)
            )
        return self.transform


def _format_pairs(pairs: NDArray[np.intp]) -> str:
    """Format pairs for display, counting from 1."""
    return "image-physical " + " ".join(f"{i + 1}-{j + 1}" for i, j in pairs.tolist())
