"""The thesis' correspondence protocol: 3 patients, 3 to 8 fiducials, 0 to 4 outliers, both noises.

Every run is solved by each method on the same points. A run succeeds when the exact pairs are returned; it
is a false positive when others are; else it is unsuccessful.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from procedures.registration.correspondence import MatchStatus, Prior
from procedures.registration.matching import match
from procedures.registration.similarity_matrix import match_many_by_similarity
from procedures.studies.heads import (
    DISPLACED_MM,
    IMAGE_SIGMA_MM,
    OUTLIER_BALL_MM,
    PATIENTS,
    PHYSICAL_SIGMA_MM,
    SITES,
    NoiseReading,
    any_pose,
    disturbance,
    in_balls,
    per_axis_mm,
    sites_mm,
)
from procedures.studies.unit import Sums, Unit, blocks, generator

Array = NDArray[np.float64]
Pairs = frozenset[tuple[int, int]]

FIDUCIALS = tuple(range(3, 9))
OUTLIERS = tuple(range(5))
BLOCK_RUNS = 500
PRIOR_DISTURBED_RAD = math.radians(20.0)  # the true orientation is disturbed by up to this
SUCCESS, UNSUCCESSFUL, FALSE = "success", "unsuccessful", "false"


class Method(StrEnum):
    """Ours, ours with what a plan knows beforehand, and the thesis'."""

    CLIQUE = "clique"
    PRIOR = "clique + orientation"
    COUNT = "clique + planned count"
    THESIS = "thesis"


OURS = (Method.CLIQUE, Method.PRIOR, Method.COUNT)


@dataclass(frozen=True)
class Reading:
    """Shuffled points of both sides with outliers, which belong together, and the true rotation."""

    image_mm: Array
    physical_mm: Array
    pairs: Pairs
    rotation: Rotation


@dataclass(frozen=True)
class CorrespondenceStudy:
    """`runs` for each patient and cell. The thesis' method is tried with each e of `tolerances_mm`."""

    runs: int
    seed: int = 0
    methods: tuple[Method, ...] = (Method.CLIQUE, Method.PRIOR, Method.THESIS)
    tolerances_mm: tuple[float, ...] = (3.0,)
    readings: tuple[NoiseReading, ...] = tuple(NoiseReading)
    fiducials: tuple[int, ...] = FIDUCIALS
    name: str = "correspondence"

    def parameters(self) -> dict[str, object]:
        """Everything that the numbers depend on."""
        return {
            key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()
        }

    def units(self) -> Sequence[Unit]:
        """Cells in the order reading, patient, fiducials, outliers."""
        return [
            unit
            for reading in self.readings
            for patient in PATIENTS
            for count in self.fiducials
            for outliers in OUTLIERS
            for unit in blocks(cell_key(reading, patient, count, outliers), self.runs, BLOCK_RUNS)
        ]

    def run(self, unit: Unit) -> Sums:
        """Outcomes of every method, as `method|e|outcome` -> count."""
        reading, patient, count, outliers = cell_of(unit.cell)
        random = generator(self.seed, unit)
        sites = sites_mm(patient)
        seen = [one_reading(sites, count, outliers, reading, random) for _ in range(unit.runs)]
        tilts = [Rotation.from_rotvec(in_balls(1, PRIOR_DISTURBED_RAD, random)[0]) for _ in seen]
        sums: Counter[str] = Counter()
        for method in self.methods:
            if method in OURS:
                for one, tilt in zip(seen, tilts, strict=True):
                    sums[outcome_key(method, None, _by_clique(one, method, count, reading, tilt))] += 1
        if Method.THESIS in self.methods:
            sums += _by_thesis(seen, self.tolerances_mm)
        return {key: float(value) for key, value in sums.items()}


def cell_key(reading: NoiseReading, patient: int, fiducials: int, outliers: int) -> str:
    """A cell as text."""
    return f"{reading.value}|{patient}|{fiducials}|{outliers}"


def cell_of(key: str) -> tuple[NoiseReading, int, int, int]:
    """A cell from its text."""
    reading, patient, fiducials, outliers = key.split("|")
    return NoiseReading(reading), int(patient), int(fiducials), int(outliers)


def outcome_key(method: Method, tolerance_mm: float | None, outcome: str) -> str:
    """What is counted."""
    return f"{method.value}|{'' if tolerance_mm is None else tolerance_mm}|{outcome}"


def one_reading(
    sites: Array, count: int, outliers: int, noise: NoiseReading, random: np.random.Generator
) -> Reading:
    """One run of the protocol: displaced sites, a random subset, noise, outliers, both sides shuffled."""
    displaced = sites + in_balls(SITES, DISPLACED_MM, random)
    points = displaced[random.choice(SITES, count, replace=False)]
    truth = any_pose(random)
    image = points + disturbance((count, 3), IMAGE_SIGMA_MM, noise, random)
    physical = truth.apply(points) + disturbance((count, 3), PHYSICAL_SIGMA_MM, noise, random)
    image = np.vstack([image, image.mean(axis=0) + in_balls(outliers, OUTLIER_BALL_MM, random)])
    physical = np.vstack([physical, physical.mean(axis=0) + in_balls(outliers, OUTLIER_BALL_MM, random)])
    image_order, physical_order = random.permutation(len(image)), random.permutation(len(physical))
    where_image, where_physical = np.argsort(image_order), np.argsort(physical_order)
    pairs = frozenset((int(where_image[k]), int(where_physical[k])) for k in range(count))
    return Reading(image[image_order], physical[physical_order], pairs, truth.rotation)


def verdict(status: MatchStatus, pairs: NDArray[np.intp], right: Pairs) -> str:
    """Exact pairs succeed; a unique answer with others is false."""
    if status is not MatchStatus.UNIQUE:
        return UNSUCCESSFUL
    return SUCCESS if frozenset((int(i), int(j)) for i, j in pairs) == right else FALSE


def _by_clique(one: Reading, method: Method, count: int, noise: NoiseReading, tilt: Rotation) -> str:
    found = match(
        one.image_mm,
        one.physical_mm,
        sigma_image_mm=per_axis_mm(IMAGE_SIGMA_MM, noise),
        sigma_physical_mm=per_axis_mm(PHYSICAL_SIGMA_MM, noise),
        expected=count if method is Method.COUNT else None,
        prior=Prior(tilt * one.rotation) if method is Method.PRIOR else None,
    )
    return verdict(found.status, found.pairs, one.pairs)


def _by_thesis(seen: list[Reading], tolerances_mm: Sequence[float]) -> Counter[str]:
    image, physical = np.array([one.image_mm for one in seen]), np.array([one.physical_mm for one in seen])
    sums: Counter[str] = Counter()
    for tolerance_mm in tolerances_mm:
        found = match_many_by_similarity(image, physical, np.full(len(seen), tolerance_mm))
        for one, pairs in zip(seen, found, strict=True):
            sums[outcome_key(Method.THESIS, tolerance_mm, verdict(pairs.status, pairs.pairs, one.pairs))] += 1
    return sums
