"""One error of the arm far larger than stated, the rest as told: whether `learning` notices, and what holds.

The hypotheses of `learning` scale all errors of an arm together, so one alone is not among them. Residuals
and errors at the targets are drawn from the registration's own model, so that nothing else is wrong.
"""

from __future__ import annotations

import json
import sys

import numpy as np

from procedures.registration.target_prediction import SharedErrors
from ronna_hw.arrays import Array
from studies.accuracy.many_learned import TargetSources
from studies.accuracy.phantom import FREE_SPHERES, Markers, draw_phantom
from studies.strategies.learning import TARGETS_OF_CASE, Prepared, plan_case
from studies.strategies.study import DEPTHS_MM

PLACES = (25, 26, 27)  # of the head before the arm; no other study of `learning` uses them
RUNS = 400  # of each place and size
FACTORS = (1.0, 2.0, 3.0, 5.0, 12.0)  # of the stated size
GROUP = "harmonics and sag"  # of the arm's errors, of which sag is the last
REFUSING = 0.999


def draw_errors(
    targets: tuple[TargetSources, ...], factor: float, random: np.random.Generator
) -> tuple[Array, Array]:
    """Draw residuals (r, n, 3) mm and errors (r, t, 3) mm at targets, with sag `factor` times as large."""
    first = targets[0]
    residuals_mm, at_targets_mm = np.zeros(()), np.zeros((RUNS, len(targets), 3))
    for group in ("arm", "others"):
        for number, source in enumerate(getattr(first, group)):
            same = [getattr(target, group)[number] for target in targets]
            if isinstance(source, SharedErrors):
                drawn = random.normal(size=(RUNS, source.at_spheres_mm.shape[2]))
                if source.source == GROUP:
                    drawn[:, -1] *= factor
                residuals_mm = residuals_mm - np.einsum("nik,rk->rni", source.at_spheres_mm, drawn)
                at_targets_mm += np.stack([drawn @ one.at_target_mm.T for one in same], axis=1)
            else:
                residuals_mm = residuals_mm - _draw(source.at_spheres_mm2, random)
                at_targets_mm += _draw(np.array([one.at_target_mm2 for one in same]), random)
    return residuals_mm, at_targets_mm


def _draw(covariances_mm2: Array, random: np.random.Generator) -> Array:
    """Draw independent errors (r, k, 3) mm with covariances (k, 3, 3) mm2, which may be singular."""
    values, vectors = np.linalg.eigh(np.asarray(covariances_mm2))
    roots = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return np.asarray(np.einsum("kij,rkj->rki", roots, random.normal(size=(RUNS, *roots.shape[:2]))))


def judge_cases(seed: int) -> dict[str, dict[str, float]]:
    """Return by factor how many cases are refused, and at the targets of the others error and coverage.

    A case is refused by its residual, or by the checks for moved spheres and for too large errors.
    """
    phantom = draw_phantom(Markers.FREE, DEPTHS_MM, TARGETS_OF_CASE)
    counts = {factor: np.zeros(6) for factor in FACTORS}  # cases, refused, by residual, targets, covered, mm
    for place in PLACES:
        planner = plan_case("uncalibrated", phantom, place)
        prepared = Prepared.of(planner, planner.choose(planner.candidates(), FREE_SPHERES), learns=True)
        for targets, used, registration in prepared.registrations:
            _, sources = planner.sources(prepared.looks, used, list(targets))
            for factor in FACTORS:
                random = np.random.default_rng([seed, place, round(10.0 * factor)])
                residuals_mm, at_targets_mm = draw_errors(tuple(sources), factor, random)
                judged = registration.judge(residuals_mm)
                by_residual = judged.refused(REFUSING)
                passed = np.logical_not(by_residual | judged.suspect)
                errors_mm = np.linalg.norm(at_targets_mm + judged.shifts_mm, axis=2)[passed]
                covered = errors_mm <= judged.limits_mm()[passed]
                refused = (RUNS - passed.sum(), by_residual.sum())
                found = (RUNS, *refused, covered.size, covered.sum(), errors_mm.sum())
                counts[factor] += np.array(found, dtype=float)
    return {
        f"x{factor:g}": {
            "cases": cases,
            "refused_percent": 100.0 * refused / cases,
            "refused_by_residual_percent": 100.0 * by_residual / cases,
            "mean_mm": total_mm / targets,
            "within_95_percent_limit": 100.0 * covered / targets,
        }
        for factor, (cases, refused, by_residual, targets, covered, total_mm) in counts.items()
    }


def main() -> None:
    """Print the table of the seed given as argument, in JSON."""
    sys.stdout.write(json.dumps(judge_cases(int(sys.argv[1])), indent=1) + "\n")


if __name__ == "__main__":
    main()
