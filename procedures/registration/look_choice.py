"""Choice of the looks that teach most about the arm and the place of the head, before any is taken.

The covariance of a linear adjustment does not depend on what the looks will show, so they are chosen when the
paths are planned. Each next look is the one that lowers the predicted error at the targets most for its
seconds (greedy A-optimal design; Atkinson, Donev and Tobias, Optimum experimental designs, 2007, chapter 12).
Then each chosen look is exchanged for the best in its place.
The unknowns are the pose of the head, the errors of the arm and those of each sphere; a look adds a rank of
three, so their covariance is updated rather than inverted again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, reduce
from typing import Self

import numpy as np
from scipy.linalg import block_diag

from procedures.registration.rigid_fit import pose_jacobian
from ronna_hw.arrays import Array

AXES = 3
# Of the pose before any look: nothing is known of it. Far above any coarse registration.
POSE_SD = (*[0.05] * 3, *[20.0] * 3)  # rad, mm
# A look that lowers the rms error at the targets by less for its seconds is not taken. (U) At 5 s a look, 2.5
# micrometres.
LEAST_GAIN_MM_PER_S = 0.0005
LEAST_RATE_MM_PER_S = 1e-6  # of equal looks, the faster one
EXCHANGES = 6  # of every chosen look for a better one (Fedorov 1972); two or three change anything


@dataclass(frozen=True)
class Candidates:
    """Looks that the arm can take: sphere of each (c,), its place (c, 3) mm, seconds (c,).

    `arm_mm` (c, 3, k) are the displacements by each independent unit error of the arm, `sphere_mm2` (n, 3, 3)
    the covariances of the spheres' places, `look_mm2` (3, 3) that of one look alone.
    """

    spheres: Sequence[int]
    points_mm: Array
    seconds: Array
    arm_mm: Array
    sphere_mm2: Array
    look_mm2: Array


@dataclass(frozen=True)
class ChosenLooks:
    """Chosen candidates, and the rms error in mm after each as it was added; the last is that of all."""

    candidates: tuple[int, ...]
    rms_mm: tuple[float, ...]


def choose_looks(
    looks: Candidates,
    targets_mm: Array,
    targets_arm_mm: Array,
    most: int,
    least_gain_mm_per_s: float = LEAST_GAIN_MM_PER_S,
) -> ChosenLooks:
    """Choose up to `most` looks for targets (t, 3) mm with the arm's displacements (t, 3, k) there.

    Every sphere is looked at, so that one that has moved is noticed. After that a look must be worth its
    seconds.
    """
    spheres = np.asarray(looks.spheres)
    centre = looks.points_mm.mean(axis=0)
    count = len(looks.sphere_mm2)
    of_sphere = np.eye(count)[spheres]
    seen = np.concatenate(  # of what a look measures, by each unknown
        [
            pose_jacobian(looks.points_mm, centre),
            -looks.arm_mm,
            np.einsum("cn,ij->cinj", of_sphere, np.eye(AXES)).reshape(len(spheres), AXES, -1),
        ],
        axis=2,
    )
    aims = np.concatenate(
        [
            pose_jacobian(targets_mm, centre),
            -targets_arm_mm,
            np.zeros((len(targets_mm), AXES, AXES * count)),
        ],
        axis=2,
    ).reshape(-1, seen.shape[2])
    covariance = block_diag(np.diag(np.square(POSE_SD)), np.eye(looks.arm_mm.shape[2]), *looks.sphere_mm2)
    design = nothing = _Design(seen, aims, looks.look_mm2, covariance)
    chosen: list[int] = []
    rms_mm: list[float] = []
    while len(chosen) < min(most, len(spheres)):
        free = _allowed(spheres, chosen, count)
        if not len(free):
            break
        worth = (design.rms_mm - design.rms_with_mm()) / looks.seconds
        best = int(free[worth[free].argmax()])
        if len(np.unique(spheres[chosen])) == count and worth[best] < least_gain_mm_per_s:
            break
        chosen.append(best)
        design = design.with_look(best)
        rms_mm.append(design.rms_mm)
    rate = max(least_gain_mm_per_s, LEAST_RATE_MM_PER_S)
    for _ in range(EXCHANGES):
        before = list(chosen)
        for place, look in enumerate(before):
            others = [one for one in chosen if one != look]
            without = reduce(_Design.with_look, others, nothing)  # taking away again is not stable
            free = _allowed(spheres, others, count)
            cost = without.rms_with_mm() + rate * looks.seconds
            best = int(free[cost[free].argmin()])
            chosen[place] = best
            design = without.with_look(best)
        if chosen == before:
            break
    return ChosenLooks(tuple(chosen), (*rms_mm[:-1], design.rms_mm))


def _allowed(spheres: Array, chosen: Sequence[int], count: int) -> Array:
    """Return the looks that may come next: at spheres without one, as long as there are any."""
    free = np.setdiff1d(np.arange(len(spheres)), chosen)
    unseen = np.setdiff1d(np.arange(count), spheres[list(chosen)])
    return free[np.isin(spheres[free], unseen)] if len(unseen) else free


@dataclass(frozen=True)
class _Design:
    """Covariance (u, u) of the unknowns after some looks.

    `seen` (c, 3, u) is what each look measures, `aims` (3t, u) the errors at the targets.
    """

    seen: Array
    aims: Array
    look_mm2: Array
    covariance: Array

    @cached_property
    def rms_mm(self) -> float:
        """Rms error over all targets."""
        return float(
            np.sqrt(AXES * np.einsum("ai,ij,aj->", self.aims, self.covariance, self.aims) / len(self.aims))
        )

    def rms_with_mm(self) -> Array:
        """Return the rms error (c,) with each further look."""
        spread = self.seen @ self.covariance
        innovation = np.linalg.inv(spread @ self.seen.transpose(0, 2, 1) + self.look_mm2)
        on_aims = spread @ self.aims.T
        gains_mm2 = AXES * np.einsum("cia,cij,cja->c", on_aims, innovation, on_aims) / len(self.aims)
        return np.asarray(np.sqrt(np.maximum(self.rms_mm**2 - gains_mm2, 0.0)))

    def with_look(self, look: int) -> Self:
        """Return the design with one more look."""
        spread = self.seen[look] @ self.covariance
        innovation = np.linalg.inv(spread @ self.seen[look].T + self.look_mm2)
        return replace(self, covariance=self.covariance - spread.T @ innovation @ spread)
