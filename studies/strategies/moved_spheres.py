"""One sphere that moved since the scan, with strategies `learning` and `ocs`: what is refused, what passes.

Each sphere of three, four and five is displaced in random directions. Arms, CT and noise are drawn from what
is stated, the arms also twice as bad. What passes reaches its targets, with the limit that it states. For
some of it, the shift of the targets by the displacement is held against the bound that `learning` states.
The tracker sees the spheres with errors as a case states them, each sphere with its own; what is refused
without it is counted too.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from procedures.registration.moved_sphere import MovedSpheres
from procedures.registration.target_prediction import influence_of_spheres
from procedures.registration.tracker_view import TrackerView
from procedures.room.model import FIELD_MM
from procedures.steps.clinical.error_budget import GROSS_MM
from ronna_hw.arrays import Array
from ronna_hw.calibrated_arm.error_budget import UNCALIBRATED_MM
from studies.accuracy.many_learned import LearnedRegistration, PlainRegistration, TargetSources
from studies.accuracy.phantom import Markers, counts_of, draw_phantom
from studies.accuracy.scene import AXES, FINE_CT_MM
from studies.strategies.learning import DRAWN, REFUSAL, SCENARIOS, TARGETS_OF_CASE, plan_case
from studies.strategies.moved_pairs import draw_case
from studies.strategies.study import DEPTHS_MM

# No other study uses these places and trajectories.
CASES = ((29, 46), (30, 55))  # place, first trajectory
SIZES_MM = (0.0, 0.5, 1.0, 2.0)
SHARES = (1.0, 2.0)
ARMS = 40  # of each sphere, size and share in each case
BOUND_ARMS, BOUND_AT_MM = 2, 0.5  # of those that pass in each case, with this displacement
SEEN_MM = np.hypot(FIELD_MM, FINE_CT_MM / np.sqrt(3.0))  # of a sphere as the tracker sees it, per axis
SEED = 7377
TRACKER_KEY = 1  # of the tracker's random numbers: all others are those of the study without it
Row = dict[str, NDArray[Any]]


@dataclass(frozen=True, eq=False)
class MovedSphere:
    """One sphere of each arm displaced: looks at it and the residuals of all."""

    numbers: Array  # (a,) of the sphere
    unmoved_mm: Array  # (a, 3m)
    residuals_mm: Array  # (a, 3m)
    moved_mm: Array  # (a, 3)
    errors_mm: Array  # (a, t, 3) of the tool at the targets

    @classmethod
    def draw(
        cls,
        random: np.random.Generator,
        spheres: Sequence[int],
        targets: Sequence[TargetSources],
        size_mm: float,
        share: float,
    ) -> MovedSphere:
        """Draw arms with looks at these spheres (m,), one of which has moved."""
        numbers = np.repeat(sorted(set(spheres)), ARMS)
        unmoved, errors = draw_case(random, targets, len(spheres), len(numbers), share)
        towards = random.normal(size=(len(numbers), AXES))
        moved = size_mm * towards / np.linalg.norm(towards, axis=1, keepdims=True)
        is_look = np.equal(numbers[:, None], spheres)
        displaced = unmoved + (is_look[..., None] * moved[:, None]).reshape(unmoved.shape)
        return cls(numbers, unmoved, displaced, moved, errors)

    def seen_mm(self, random: np.random.Generator) -> Array:
        """Return the residuals (a, 3n) mm of the spheres as the tracker sees them."""
        each = np.unique(self.numbers)
        errors = SEEN_MM * random.normal(size=(len(self.numbers), len(each), AXES))
        seen = errors + np.equal(self.numbers[:, None], each)[..., None] * self.moved_mm[:, None]
        return np.asarray(seen.reshape(len(seen), -1))


def view_spheres(points_mm: Array, spheres: Sequence[int]) -> TrackerView:
    """Return a view of the spheres (m,) of looks at points (m, 3) mm, by what the tracker errs."""
    _, first = np.unique(spheres, return_index=True)
    covariances_mm2 = np.tile(np.diag(SEEN_MM**2), (len(first), 1, 1))
    own_mm = points_mm[first]
    return TrackerView.of(own_mm, own_mm, covariances_mm2, np.zeros((own_mm.size, own_mm.size)))


def run_learning(
    random: np.random.Generator,
    tracker: np.random.Generator,
    prepared: tuple[list[int], Array, list[TargetSources]],
    size_mm: float,
    share: float,
) -> Row:
    """Judge arms by `learning`."""
    spheres, points, targets = prepared
    registration = LearnedRegistration.of(points, spheres, targets, view_spheres(points, spheres))
    drawn = MovedSphere.draw(random, spheres, targets, size_mm, share)
    seen, residuals = drawn.seen_mm(tracker), drawn.residuals_mm.reshape(len(drawn.numbers), -1, AXES)
    by_looks, judged = registration.judge(residuals), registration.judge(residuals, seen)
    passed_looks = ~by_looks.refused(REFUSAL) & ~by_looks.suspect
    moved = registration.checks.judge(drawn.residuals_mm, seen).moved
    found: Row = {
        "passed": ~judged.refused(REFUSAL) & ~judged.suspect,
        "passed_looks": passed_looks,
        "named": np.array([_names(moved, arm, int(one)) for arm, one in enumerate(drawn.numbers)]),
        "errors_mm": np.linalg.norm(judged.shifts_mm + drawn.errors_mm, axis=2),
        "limits_mm": judged.limits_mm(),
    }
    if size_mm == BOUND_AT_MM:
        checked = random.permutation(np.flatnonzero(passed_looks))[:BOUND_ARMS]
        found["bounds"] = np.array([_is_bounded(registration, drawn, int(arm)) for arm in checked])
    return found


def _names(moved: MovedSpheres, arm: int, number: int) -> bool:
    """Return whether this sphere alone is suspected."""
    return moved.suspects(arm) == ((number,),)


def _is_bounded(registration: LearnedRegistration, drawn: MovedSphere, arm: int) -> bool:
    """Return whether the displacement shifts every target by no more than its stated bound."""
    both = np.stack([drawn.unmoved_mm[arm], drawn.residuals_mm[arm]])
    odds = registration.planned.judge(both).probabilities
    passing = registration.checks.find_passing(both[1], GROSS_MM)
    for target in registration.targets:
        (unmoved_mm, moved_mm), _ = target.correct(both, odds)
        others_mm, _ = target.correct(passing.residuals_mm, passing.probabilities)
        if np.linalg.norm(moved_mm - unmoved_mm) > np.linalg.norm(others_mm - moved_mm, axis=1).max():
            return False
    return True


def run_plain(
    random: np.random.Generator,
    prepared: tuple[list[int], Array, list[TargetSources]],
    arm_mm: float,
    size_mm: float,
    share: float,
) -> Row:
    """Judge arms by `ocs`, whose looks serve one target."""
    spheres, points, targets = prepared
    registration = PlainRegistration.of(points, targets, arm_mm)
    drawn = MovedSphere.draw(random, spheres, targets, size_mm, share)
    judged = registration.judge(drawn.residuals_mm.reshape(len(drawn.numbers), -1, AXES))
    influence = influence_of_spheres(points, targets[0].target_mm).transpose(1, 0, 2).reshape(AXES, -1)
    errors = drawn.errors_mm[:, 0] + drawn.residuals_mm @ influence.T
    return {
        "passed": ~judged.refused(REFUSAL),
        "errors_mm": np.linalg.norm(errors, axis=1, keepdims=True),
        "limits_mm": judged.limits_mm(),
    }


def main() -> None:
    """Print shares of refused and named cases, errors and coverage, in JSON."""
    random, tracker = np.random.default_rng(SEED), np.random.default_rng([SEED, TRACKER_KEY])
    found: dict[str, Any] = {}
    drawn = draw_phantom(Markers.FREE, DEPTHS_MM, DRAWN)
    for kind in SCENARIOS:
        learned: dict[int, list[tuple[list[int], Array, list[TargetSources]]]] = {}
        plain: dict[int, list[tuple[list[int], Array, list[TargetSources]]]] = {}
        for place, first in CASES:
            own = replace(drawn, trajectories=drawn.trajectories[first : first + TARGETS_OF_CASE])
            planner = plan_case(kind, own, place)
            candidates, separate = planner.candidates(), planner.separate("ocs")
            arm_mm = UNCALIBRATED_MM * planner.sizes.links
            for count in counts_of(Markers.FREE):
                looks = planner.choose(candidates, count)
                points, targets = planner.sources(
                    looks, np.arange(len(looks.spheres)), range(TARGETS_OF_CASE)
                )
                learned.setdefault(count, []).append((looks.spheres.tolist(), points, targets))
                looks = separate.of_spheres(count)
                points, targets = planner.sources(looks, looks.used[0], [0])
                plain.setdefault(count, []).append((looks.spheres[looks.used[0]].tolist(), points, targets))
        found[kind] = {
            f"spheres_{count}": {
                f"size_{share:g}": {
                    f"moved_{1000.0 * size:.0f}_um": {
                        "learning": _summary(
                            [run_learning(random, tracker, one, size, share) for one in learned[count]]
                        ),
                        "ocs": _summary(
                            [run_plain(random, one, arm_mm, size, share) for one in plain[count]]
                        ),
                    }
                    for size in SIZES_MM
                }
                for share in SHARES
            }
            for count in learned
        }
    sys.stdout.write(json.dumps(found, indent=1) + "\n")


def _summary(parts: list[Row]) -> dict[str, float | int | None]:
    every = {name: np.concatenate([one[name] for one in parts]) for name in parts[0]}
    passed = every["passed"].astype(bool)
    errors, limits = every["errors_mm"][passed], every["limits_mm"][passed]
    found: dict[str, float | int | None] = {
        "cases": len(passed),
        "refused_percent": _percent(~passed),
        "largest_error_mm_of_passed": round(float(errors.max()), 3) if passed.any() else None,
        "within_percent_of_passed": _percent(errors <= limits),
        "beyond_percent_of_all": round(100.0 * float((errors > limits).sum() / every["errors_mm"].size), 2),
    }
    if "passed_looks" in every:
        found["refused_without_tracker_percent"] = _percent(~every["passed_looks"].astype(bool))
    if "named" in every:
        found["alone_suspected_percent_of_refused"] = _percent(every["named"][~passed])
    if "bounds" in every:
        found["bounds_checked"], found["bounds_held"] = len(every["bounds"]), int(every["bounds"].sum())
    return found


def _percent(marked: NDArray[Any]) -> float | None:
    return round(100.0 * float(np.mean(marked)), 2) if marked.size else None


if __name__ == "__main__":
    main()
