"""Choice of the looks that teach most about the arm and the place of the head, before any is taken.

The covariance of a linear adjustment does not depend on what the looks will show, so they are chosen when the
paths are planned. Each next look is the one that lowers the predicted error at the targets most for its
seconds (greedy A-optimal design; Atkinson, Donev and Tobias, Optimum experimental designs, 2007, chapter 12).
The unknowns are the pose of the head, the errors of the arm and those of each sphere; a look adds a rank of
three, so their covariance is updated rather than inverted again.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from procedures.registration.rigid_fit import pose_jacobian
from ronna_hw.arrays import Array

AXES = 3
# Of the pose before any look: nothing is known of it. Far above any coarse registration.
POSE_SD = (*[0.05] * 3, *[20.0] * 3)  # rad, mm
# A look that lowers the rms error at the targets by less for its seconds is not taken. (U) At 5 s a look, 1.5
# micrometres.
LEAST_GAIN_MM_PER_S = 0.0003


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
    """Chosen candidates in the order of their use to the targets, and the rms error in mm after each."""

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
    chosen: list[int] = []
    rms_mm = [_rms(aims, covariance, len(targets_mm))]
    while len(chosen) < min(most, len(spheres)):
        spread = seen @ covariance  # (c, 3, u)
        innovation = np.linalg.inv(spread @ seen.transpose(0, 2, 1) + looks.look_mm2)
        on_aims = spread @ aims.T  # (c, 3, 3t)
        gains_mm2 = np.einsum("cia,cij,cja->c", on_aims, innovation, on_aims) / len(targets_mm)
        after_mm = np.sqrt(np.maximum(rms_mm[-1] ** 2 - gains_mm2, 0.0))
        worth = (rms_mm[-1] - after_mm) / looks.seconds
        unseen = np.setdiff1d(np.arange(count), spheres[chosen])
        free = np.setdiff1d(np.arange(len(spheres)), chosen)
        if len(unseen):
            free = free[np.isin(spheres[free], unseen)]
        best = int(free[worth[free].argmax()]) if len(free) else -1
        if best < 0 or (not len(unseen) and worth[best] < least_gain_mm_per_s):
            break
        chosen.append(best)
        covariance = covariance - spread[best].T @ innovation[best] @ spread[best]
        rms_mm.append(_rms(aims, covariance, len(targets_mm)))
    return ChosenLooks(tuple(chosen), tuple(rms_mm[1:]))


def _rms(aims: Array, covariance: Array, targets: int) -> float:
    """Return the rms error in mm over all targets."""
    return float(np.sqrt(np.einsum("ai,ij,aj->", aims, covariance, aims) / targets))
