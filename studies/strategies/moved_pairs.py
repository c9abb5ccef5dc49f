"""Two spheres that moved together since the scan, with strategy `learning`: what the gate and the limit see.

Every pair of the five spheres is displaced by one vector of each size, in random directions. Arms, CT and
noise are drawn from what is stated, the arms also half and twice as bad. A case is refused by its checks;
what passes reaches its targets, with the limit that it states, and with the one before pairs were tested.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from procedures.registration.arm_hypotheses import Source
from procedures.registration.error_theory import DEFAULT_CONFIDENCE, error_limit_mm
from procedures.registration.moved_together import PairTest
from procedures.registration.target_prediction import SharedErrors
from ronna_hw.arrays import Array
from studies.accuracy.many_learned import LearnedRegistration, TargetSources
from studies.accuracy.phantom import FREE_SPHERES, Markers, draw_phantom
from studies.accuracy.scene import AXES
from studies.strategies.learning import DRAWN, REFUSAL, SCENARIOS, TARGETS_OF_CASE, plan_case
from studies.strategies.study import DEPTHS_MM

# No other study uses these places and trajectories.
CASES = ((27, 44), (28, 53))  # place, first trajectory
SIZES_MM = (0.0, 0.3, 0.5, 0.7, 1.0, 1.5)
SHARES = (0.5, 1.0, 2.0)
ARMS = 30  # of each pair, size and share in each case
SEED = 7276


@dataclass(frozen=True, eq=False)
class MovedCase:
    """Looks of one case, prepared for many arms."""

    spheres: NDArray[np.intp]  # (m,) of each look
    targets: tuple[TargetSources, ...]
    registration: LearnedRegistration
    test: PairTest

    @classmethod
    def of(cls, kind: str, place: int, first: int) -> MovedCase:
        """Plan the looks. Raises STU-010."""
        drawn = draw_phantom(Markers.FREE, DEPTHS_MM, DRAWN)
        own = replace(drawn, trajectories=drawn.trajectories[first : first + TARGETS_OF_CASE])
        planner = plan_case(kind, own, place)
        looks = planner.choose(planner.candidates(), FREE_SPHERES)
        points, targets = planner.sources(looks, np.arange(len(looks.spheres)), range(TARGETS_OF_CASE))
        registration = LearnedRegistration.of(points, looks.spheres.tolist(), targets)
        rows = [np.flatnonzero(looks.spheres == one).tolist() for one in range(FREE_SPHERES)]
        return cls(looks.spheres, tuple(targets), registration, PairTest.of(registration.planned, rows))

    def run(self, random: np.random.Generator, size_mm: float, share: float) -> dict[str, NDArray[Any]]:
        """Displace every pair of many arms; return flags (a,), and errors and limits (a, t) mm."""
        numbers = np.repeat(np.arange(len(self.test.pairs)), ARMS)
        residuals, errors = draw_case(random, self.targets, len(self.spheres), len(numbers), share)
        towards = random.normal(size=(len(numbers), AXES))
        moved = size_mm * towards / np.linalg.norm(towards, axis=1, keepdims=True)
        flat = residuals + np.einsum("aij,aj->ai", self.test.columns[numbers], moved)
        judged = self.registration.judge(flat.reshape(len(flat), -1, AXES))
        odds = self.registration.planned.judge(flat).probabilities
        pairs, limits_mm = self.test.judge(flat, odds), judged.limits_mm()
        with_pairs = limits_mm.copy()
        for target, planned in enumerate(self.registration.targets):
            influence = np.einsum("ah,hij->aij", odds, planned.influences)
            added = pairs.at_target(self.test.influences(influence))
            own = judged.widening[:, None, None] ** 2 * judged.covariances_mm2[:, target] + added
            with_pairs[:, target] = np.where(
                pairs.is_likely, error_limit_mm(own, DEFAULT_CONFIDENCE), limits_mm[:, target]
            )
        return {
            "passed": ~judged.refused(REFUSAL) & ~judged.suspect,
            "named": pairs.is_likely,
            "right": pairs.is_likely & (pairs.most_likely == numbers),
            "errors_mm": np.linalg.norm(judged.shifts_mm + errors, axis=2),
            "before_mm": limits_mm,
            "after_mm": with_pairs,
        }


def draw_case(
    random: np.random.Generator, targets: Sequence[TargetSources], looks: int, count: int, share: float
) -> tuple[Array, Array]:
    """Draw residuals (a, 3m) from the sources, and errors of the tool (a, t, 3) at the targets.

    The arm's errors are `share` times as large as stated.
    """
    residuals = np.zeros((count, AXES * looks))
    listed = [_factored(one, share) for one in targets]
    drawn = np.zeros((count, len(targets), AXES))
    for sources in zip(*listed, strict=True):
        factor, first = sources[0]
        if isinstance(first, SharedErrors):
            unit = factor * random.normal(size=(count, first.at_target_mm.shape[1]))
            residuals -= unit @ first.at_spheres_mm.reshape(-1, unit.shape[1]).T
            drawn += np.stack([unit @ one.at_target_mm.T for _, one in sources], axis=1)
        else:
            noise = factor * random.normal(size=(count, looks, AXES))
            roots = np.linalg.cholesky(first.at_spheres_mm2)
            residuals -= np.einsum("mij,amj->ami", roots, noise).reshape(count, -1)
            rest = [np.linalg.cholesky(one.at_target_mm2) for _, one in sources]
            drawn += np.einsum("tij,atj->ati", rest, factor * random.normal(size=drawn.shape))
    return residuals, drawn


def _factored(target: TargetSources, share: float) -> list[tuple[float, Source]]:
    return [*((share, one) for one in target.arm), *((1.0, one) for one in target.others)]


def main() -> None:
    """Print shares of refused and named cases, errors, and coverage of both limits, in JSON."""
    random, found = np.random.default_rng(SEED), {}
    for kind in SCENARIOS:
        cases = [MovedCase.of(kind, place, first) for place, first in CASES]
        found[kind] = {
            f"size_{share:g}": {
                f"moved_{1000.0 * size:.0f}_um": _summary([one.run(random, size, share) for one in cases])
                for size in SIZES_MM
            }
            for share in SHARES
        }
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


def _summary(parts: list[dict[str, NDArray[Any]]]) -> dict[str, float | int | None]:
    every = {name: np.concatenate([one[name] for one in parts]) for name in parts[0]}
    passed, named, right = (every[name].astype(bool) for name in ("passed", "named", "right"))
    named &= passed
    errors, before, after = (every[name] for name in ("errors_mm", "before_mm", "after_mm"))

    def share(marked: NDArray[np.bool_], among: NDArray[np.bool_]) -> float | None:
        return round(100.0 * float(marked[among].mean()), 2) if among.any() else None

    return {
        "cases": len(passed),
        "refused_percent": share(~passed, np.ones_like(passed)),
        "named_percent_of_passed": share(named, passed),
        "right_pair_percent_of_named": share(right, named),
        "mean_error_mm_of_passed": round(float(errors[passed].mean()), 4) if passed.any() else None,
        "largest_error_mm_of_passed": round(float(errors[passed].max()), 4) if passed.any() else None,
        "within_percent_before": share(errors <= before, passed),
        "within_percent": share(errors <= after, passed),
        "beyond_percent_of_all_before": share((errors > before) & passed[:, None], np.ones_like(passed)),
        "beyond_percent_of_all": share((errors > after) & passed[:, None], np.ones_like(passed)),
        "mean_limit_mm_of_named": round(float(after[named].mean()), 4) if named.any() else None,
    }


if __name__ == "__main__":
    main()
