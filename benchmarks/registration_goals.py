"""What pairing and rigid fit must achieve, on a small part of the studies' runs: the same code, fixed seed.

`ronna-campaign correspondence` and `registration` run them in full.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from benchmarks.figures import Figure
from procedures.planning.plan_check import LEAST_SIDE_DIFFERENCE_MM, least_side_difference_mm
from procedures.registration import match, register
from studies.campaign.unit import add_up
from studies.correspondence.readings import draw_readings
from studies.correspondence.study import (
    FALSE,
    SUCCESS,
    UNSUCCESSFUL,
    CorrespondenceStudy,
    Method,
    verdict,
)
from studies.heads import (
    IMAGE_SIGMA_MM,
    PHYSICAL_SIGMA_MM,
    NoiseReading,
    per_axis_mm,
    sites_mm,
)
from studies.registration import ISOTROPIC, RegistrationStudy, tables

RUNS_PER_CELL = {
    "5 to 8 markers": 200,
    "4 markers": 1000,
    "3 markers": 200,
}  # a share of 1 in 2,000 needs many
FIT_RUNS = 5_000
WEIGHTED_BLOCKS = 2  # of 500 runs: an iterated fit takes ten times as long
SEED = 12
EXACT_CASES = 200
OURS = "match"

# Limits in per cent unsuccessful and false, by number of markers; three without a prior, by noise model.
FIVE_TO_EIGHT, FOUR = (0.05, 0.01), (0.7, 0.05)
THREE = {NoiseReading.PER_AXIS: (20.0, 0.1), NoiseReading.NORM: (10.0, 0.1)}
WITH_PRIOR = {3: 2.0, 4: 0.05}
SIDES_APART_RUNS = 5_000  # of three markers as different in their sides as the plan's check requires
SIDES_APART_PERCENT = 0.1


def measure() -> list[Figure]:
    """Correspondence over the thesis' protocol, then the fit's formulas."""
    return [*_pairing(), *_sides_apart(), *_exact(), *_formulas()]


def _pairing() -> list[Figure]:
    figures = []
    for noise in NoiseReading:
        for name, counts, limits in (
            ("5 to 8 markers", (5, 6, 7, 8), FIVE_TO_EIGHT),
            ("4 markers", (4,), FOUR),
            ("3 markers", (3,), THREE[noise]),
        ):
            knowing = Method.PRIOR if counts[0] in WITH_PRIOR else Method.COUNT
            study = CorrespondenceStudy(
                RUNS_PER_CELL[name], SEED, (Method.CLIQUE, knowing), readings=(noise,), fiducials=counts
            )
            total: dict[str, float] = {}
            for unit in study.units():
                for key, value in study.run(unit).items():
                    total[key] = total.get(key, 0.0) + value
            for outcome, most in zip((UNSUCCESSFUL, FALSE), limits, strict=True):
                figures.append(
                    _share(f"{outcome}, {name}, {noise.value}", Method.CLIQUE, outcome, total, most)
                )
            if most := WITH_PRIOR.get(counts[0]):
                what = f"unsuccessful, {name}, {noise.value}, with orientation"
                figures.append(_share(what, Method.PRIOR, UNSUCCESSFUL, total, most))
            else:
                what = f"false, {name}, {noise.value}, with the planned count"
                figures.append(_share(what, Method.COUNT, FALSE, total, 0.0))
    return figures


def _sides_apart() -> list[Figure]:
    """Three markers with side differences as required by the plan's check: shares without a unique answer."""
    figures = []
    for noise in NoiseReading:
        random = np.random.default_rng(SEED)
        runs = failed = 0
        while runs < SIDES_APART_RUNS:
            seen = draw_readings(sites_mm(1 + runs % 3), 3, 0, noise, 1, random)
            triangle = seen.image_mm[0]
            if least_side_difference_mm(triangle) < LEAST_SIDE_DIFFERENCE_MM:
                continue
            runs += 1
            found = match(
                triangle,
                seen.physical_mm[0],
                sigma_image_mm=per_axis_mm(IMAGE_SIGMA_MM, noise),
                sigma_physical_mm=per_axis_mm(PHYSICAL_SIGMA_MM, noise),
            )
            right = frozenset((i, j) for i, j in seen.pairs[0].tolist())
            failed += verdict(found.status, found.pairs, right) != SUCCESS
        what = f"not found, 3 markers, sides {LEAST_SIDE_DIFFERENCE_MM:g} mm apart, {noise.value}"
        figure = Figure(what, OURS, 100.0 * failed / runs, "%", more={"runs": runs})
        figures.append(figure.at_most(SIDES_APART_PERCENT))
    return figures


def _share(what: str, method: Method, outcome: str, total: dict[str, float], most: float) -> Figure:
    runs = sum(total.get(f"{method.value}||{one}", 0.0) for one in (SUCCESS, UNSUCCESSFUL, FALSE))
    share = 100.0 * total.get(f"{method.value}||{outcome}", 0.0) / runs
    return Figure(what, OURS, share, "%", more={"runs": runs}).at_most(most)


def _exact() -> list[Figure]:
    """The largest rotation error on exact data."""
    random = np.random.default_rng(SEED)
    worst = 0.0
    for _ in range(EXACT_CASES):
        points = sites_mm(1)[random.choice(8, int(random.integers(3, 9)), replace=False)]
        truth = RigidTransform.from_components(random.normal(size=3) * 500.0, Rotation.random(rng=random))
        found = register(points, truth.apply(points)).transform
        worst = max(worst, float(np.abs(found.as_matrix() - truth.as_matrix())[:3, :3].max()))
    return [Figure("largest rotation error, exact data", "register", worst, "rad").at_most(1e-12)]


def _formulas() -> list[Figure]:
    study = RegistrationStudy(FIT_RUNS, SEED, fiducials=(5,))
    units = [
        unit for unit in study.units() if unit.condition.startswith(ISOTROPIC) or unit.block < WEIGHTED_BLOCKS
    ]
    formulas, gains = tables(add_up((unit, study.run(unit)) for unit in units))
    ((_, _, fle, one_space, _, _, _, tre, alarms, _),) = formulas.rows
    figures = [
        Figure("FLE by eq. 36 over the true one", "register", _number(fle), "").within(0.98, 1.02),
        Figure("FLE of one space by eq. 37, 38", "register", _number(one_space), "").within(0.98, 1.02),
        Figure("target error over eq. 39", "register", _number(tre), "").within(0.98, 1.02),
        Figure("false alarms of the FRE gate", "register", _number(alarms), "%").within(4.0, 6.0),
    ]
    for row, least in zip(gains.rows, (20.0, 40.0), strict=True):
        gain = Figure(f"target error that weighting saves, {row[0]}", "register", _number(row[6]), "%")
        figures.append(gain.at_least(least))
    return figures


def _number(value: object) -> float:
    assert isinstance(value, float)
    return value
