"""Pairing at 12 x 12 points against a plain random search, and the rigid fit against SciPy's."""

from __future__ import annotations

from statistics import median

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from benchmarks import registration_goals
from benchmarks.contest import cpu_of
from benchmarks.figures import Figure, compared
from procedures.registration import MatchStatus, match, register
from studies.heads import IMAGE_SIGMA_MM, PHYSICAL_SIGMA_MM, NoiseReading, draw_readings, sites_mm

Array = NDArray[np.float64]

CASES = 60
COMMON, STRANGERS = 8, 4  # 12 points on either side
SEARCH_TRIES = 1000
SEARCH_TOLERANCE_MM = 3.0
FIT_POINTS = 5
FIT_REPEATS = 20
MOST_MS = 2.0
OURS, SEARCH, SCIPY = "match", "random triples, NumPy", "SciPy align_vectors"


def measure() -> list[Figure]:
    """Both measurements, on the same random cases for all, and the goals on the studies' own."""
    return [*_pairing(), *_fit(), *registration_goals.measure()]


def _pairing() -> list[Figure]:
    samples: dict[str, list[float]] = {OURS: [], SEARCH: []}
    right = dict.fromkeys(samples, 0)
    generator = np.random.default_rng(12)
    noise = NoiseReading.PER_AXIS
    seen = draw_readings(sites_mm(1), COMMON, STRANGERS, noise, CASES, generator)
    for image, physical, paired in zip(seen.image_mm, seen.physical_mm, seen.pairs.tolist(), strict=True):
        pairs = {(i, j) for i, j in paired}
        found: dict[str, set[tuple[int, int]]] = {}

        def ours(image: Array = image, physical: Array = physical) -> None:
            result = match(
                image, physical, sigma_image_mm=IMAGE_SIGMA_MM, sigma_physical_mm=PHYSICAL_SIGMA_MM
            )
            unique = result.status is MatchStatus.UNIQUE
            found[OURS] = {(int(a), int(b)) for a, b in result.pairs} if unique else set()  # noqa: B023

        def search(image: Array = image, physical: Array = physical) -> None:
            found[SEARCH] = _random_search(image, physical, generator)  # noqa: B023

        for name, work in ((OURS, ours), (SEARCH, search)):
            samples[name].append(cpu_of(work))
            right[name] += found[name] == pairs
    ours_ms, search_ms = compared("CPU per pairing, 12 x 12 points", "ms", samples, SEARCH, scale=1e3)
    return [
        ours_ms.at_most(MOST_MS),
        search_ms,
        *(
            Figure("pairings found, complete and right", name, 100 * right[name] / CASES, "%")
            for name in right
        ),
    ]


def _random_search(image: Array, physical: Array, generator: np.random.Generator) -> set[tuple[int, int]]:
    """The obvious first attempt: fit random triples to random triples, keep the largest consensus."""
    tree = cKDTree(physical)
    best: set[tuple[int, int]] = set()
    for _ in range(SEARCH_TRIES):
        a = generator.choice(len(image), 3, replace=False)
        b = generator.choice(len(physical), 3, replace=False)
        sides = [np.linalg.norm(p[[0, 1, 2]] - p[[1, 2, 0]], axis=1) for p in (image[a], physical[b])]
        if np.abs(sides[0] - sides[1]).max() > SEARCH_TOLERANCE_MM:
            continue
        rotation, translation = _kabsch(image[a], physical[b])
        distance, nearest = tree.query(image @ rotation.T + translation)
        pairs = {(int(k), int(nearest[k])) for k in np.flatnonzero(distance < SEARCH_TOLERANCE_MM)}
        if len(pairs) > len(best):
            best = pairs
    return best


def _kabsch(source: Array, target: Array) -> tuple[Array, Array]:
    middle, centre = source.mean(axis=0), target.mean(axis=0)
    u, _, vt = np.linalg.svd((target - centre).T @ (source - middle))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return rotation, centre - rotation @ middle


def _fit() -> list[Figure]:
    generator = np.random.default_rng(5)
    equal, weighted = "register", "register with covariances"
    samples: dict[str, list[float]] = {equal: [], weighted: [], SCIPY: []}
    apart: list[float] = []
    for _ in range(CASES):
        image = sites_mm(1)[generator.choice(8, FIT_POINTS, replace=False)]
        turn = Rotation.random(random_state=generator)
        physical = turn.apply(image) + generator.normal(0.0, 0.2, image.shape)
        spread = np.diag([0.01, 0.01, 0.09])
        covariance = np.array([spread * scale for scale in generator.uniform(0.5, 2.0, FIT_POINTS)])

        def scipy_fit(image: Array = image, physical: Array = physical) -> Rotation:
            rotation, _ = Rotation.align_vectors(physical - physical.mean(axis=0), image - image.mean(axis=0))
            return rotation

        samples[equal].append(cpu_of(lambda a=image, b=physical: register(a, b), FIT_REPEATS))  # type: ignore[misc]
        samples[weighted].append(
            cpu_of(lambda a=image, b=physical, c=covariance: register(a, b, covariance_mm2=c), FIT_REPEATS)  # type: ignore[misc]
        )
        samples[SCIPY].append(cpu_of(scipy_fit, FIT_REPEATS))
        ours = Rotation.from_matrix(np.asarray(register(image, physical).transform.as_matrix())[:3, :3])
        apart.append(float((ours.inv() * scipy_fit()).magnitude()))
    return [
        *compared("CPU per rigid fit, 5 points", "µs", samples, SCIPY, scale=1e6),
        Figure("rotation apart from SciPy's", equal, median(apart), "rad"),
    ]
