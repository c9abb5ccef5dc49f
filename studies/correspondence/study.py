"""The thesis' correspondence protocol: 3 patients, 3 to 8 fiducials, 0 to 4 outliers, both noise models.

Each method solves every run on the same points. A run is successful if exactly the true pairs are returned.
It is false with a wrong pair, partial if the pairs are right but incomplete, and otherwise lost. The thesis
counts a partial result as unsuccessful (success is exact count and exact order), our goals count it as false.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from enum import StrEnum
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from procedures.registration.correspondence import (
    DEFAULT_PRIOR_TOLERANCE_RAD,
    Match,
    MatchStatus,
    Prior,
    turn_rad,
)
from procedures.registration.matching import match
from procedures.registration.similarity_matrix import match_many_by_similarity, validate_many
from procedures.registration.thesis_settings import REFUSED_SHARE
from studies.campaign.study import Sums, Unit, blocks, generator, omit_empty_own
from studies.heads import (
    IMAGE_SIGMA_MM,
    PATIENTS,
    PHYSICAL_SIGMA_MM,
    NoiseReading,
    Readings,
    draw_readings,
    per_axis_mm,
    sites_mm,
    uniform_in_ball,
    variance_from_thesis_mm2,
)
from studies.plugins.answers import PluginPairing
from studies.plugins.method import PluginMethod

Array = NDArray[np.float64]
Pairs = frozenset[tuple[int, int]]

FIDUCIALS = tuple(range(3, 9))
OUTLIERS = tuple(range(5))
BLOCK_RUNS = 500
PRIOR_DISTURBED_RAD = math.radians(20.0)  # largest error of the orientation given as a prior
SUCCESS, LOST, PART, FALSE = "success", "lost", "part", "false"
# The first brings the thesis' method closest to its figures for 3 and 4 markers, the second for 5 to 8.
USUAL_TOLERANCES_MM = (1.5, 2.5)


class StudiedMatching(StrEnum):
    """Our method, alone or with prior knowledge from the plan; the thesis' method, raw or validated."""

    CLIQUE = "clique"
    PRIOR = "clique + orientation"
    COUNT = "clique + planned count"
    THESIS = "thesis"
    VALIDATED = "thesis, validated"


OURS = (StudiedMatching.CLIQUE, StudiedMatching.PRIOR, StudiedMatching.COUNT)
OF_THE_THESIS = (StudiedMatching.THESIS, StudiedMatching.VALIDATED)


@dataclass(frozen=True)
class CorrespondenceStudy:
    """Correspondence study with `runs` per condition, and every e in `tolerances_mm` for the thesis' methods.

    The thesis' validation refuses `refused_share` of the correct pairings.
    """

    runs: int
    seed: int = 0
    methods: tuple[StudiedMatching, ...] = tuple(StudiedMatching)
    tolerances_mm: tuple[float, ...] = USUAL_TOLERANCES_MM
    readings: tuple[NoiseReading, ...] = tuple(NoiseReading)
    fiducials: tuple[int, ...] = FIDUCIALS
    name: str = "correspondence"
    own: tuple[PluginMethod, ...] = ()
    refused_share: float = REFUSED_SHARE

    def settings(self) -> dict[str, object]:
        return omit_empty_own(asdict(self))

    def units(self) -> Sequence[Unit]:
        """List the units in the order noise model, patient, fiducials, outliers."""
        return [
            unit
            for reading in self.readings
            for patient in PATIENTS
            for count in self.fiducials
            for outliers in OUTLIERS
            for unit in blocks(condition_key(reading, patient, count, outliers), self.runs, BLOCK_RUNS)
        ]

    def run(self, unit: Unit) -> Sums:
        """Count the outcomes of every method, keyed `method|e|outcome`."""
        reading, patient, count, outliers = condition_of(unit.condition)
        random = generator(self.seed, unit)
        seen = draw_readings(sites_mm(patient), count, outliers, reading, unit.runs, random)
        tilts = Rotation.from_rotvec(uniform_in_ball(unit.runs, PRIOR_DISTURBED_RAD, random))
        priors = tilts * seen.rotations
        prior_matrices = np.asarray(priors.as_matrix())
        rights = [frozenset((i, j) for i, j in one) for one in seen.pairs.tolist()]
        sums: Counter[str] = Counter()
        ours = [method for method in self.methods if method in OURS]
        if ours:
            for run, right in enumerate(rights):
                solve = partial(pair_points, seen.image_mm[run], seen.physical_mm[run], reading)
                plain = solve()
                for method in ours:
                    found = plain
                    if method is StudiedMatching.COUNT:
                        found = solve(expected=count)
                    elif method is StudiedMatching.PRIOR and not _satisfies_prior(plain, prior_matrices[run]):
                        found = solve(prior=Prior(priors[run]))
                    sums[outcome_key(method, None, verdict(found.status, found.pairs, right))] += 1
        if any(method in OF_THE_THESIS for method in self.methods):
            sums += self._count_thesis_outcomes(seen, rights, reading)
        for own in self.own:
            sums += _count_plugin_outcomes(PluginPairing.of(own), seen, rights, reading)
        return {key: float(value) for key, value in sums.items()}

    def _count_thesis_outcomes(
        self, seen: Readings, rights: Sequence[Pairs], noise: NoiseReading
    ) -> Counter[str]:
        """Count the outcomes of the thesis' pairing for every e, before and after its validation."""
        sums: Counter[str] = Counter()
        for tolerance_mm in self.tolerances_mm:
            found = match_many_by_similarity(
                seen.image_mm, seen.physical_mm, np.full(len(seen), tolerance_mm)
            )
            answers = {StudiedMatching.THESIS: found}
            if StudiedMatching.VALIDATED in self.methods:
                answers[StudiedMatching.VALIDATED] = validate_many(
                    seen.image_mm,
                    seen.physical_mm,
                    found,
                    variance_from_thesis_mm2(noise),
                    self.refused_share,
                )
            for method in answers.keys() & set(self.methods):
                for right, one in zip(rights, answers[method], strict=True):
                    sums[outcome_key(method, tolerance_mm, verdict(one.status, one.pairs, right))] += 1
        return sums


def _count_plugin_outcomes(
    pairing: PluginPairing, seen: Readings, rights: Sequence[Pairs], noise: NoiseReading
) -> Counter[str]:
    sums: Counter[str] = Counter()
    for image_mm, physical_mm, right in zip(seen.image_mm, seen.physical_mm, rights, strict=True):
        found = pairing(
            image_mm,
            physical_mm,
            sigma_image_mm=per_axis_mm(IMAGE_SIGMA_MM, noise),
            sigma_physical_mm=per_axis_mm(PHYSICAL_SIGMA_MM, noise),
        )
        judged = LOST if found is None else verdict(MatchStatus.UNIQUE, found, right)
        sums[outcome_key(pairing.name, None, judged)] += 1
    return sums


def condition_key(reading: NoiseReading, patient: int, fiducials: int, outliers: int) -> str:
    return f"{reading.value}|{patient}|{fiducials}|{outliers}"


def condition_of(key: str) -> tuple[NoiseReading, int, int, int]:
    """Parse a condition key."""
    reading, patient, fiducials, outliers = key.split("|")
    return NoiseReading(reading), int(patient), int(fiducials), int(outliers)


def outcome_key(method: str, tolerance_mm: float | None, outcome: str) -> str:
    return f"{method}|{'' if tolerance_mm is None else tolerance_mm}|{outcome}"


def verdict(status: MatchStatus, pairs: NDArray[np.intp], right: Pairs) -> str:
    if status is not MatchStatus.UNIQUE:
        return LOST
    found_pairs = frozenset((i, j) for i, j in pairs.tolist())
    if found_pairs == right:
        return SUCCESS
    return PART if found_pairs < right else FALSE


def pair_points(
    image_mm: Array,
    physical_mm: Array,
    noise: NoiseReading,
    expected: int | None = None,
    prior: Prior | None = None,
) -> Match:
    """Pair by our method, assuming the errors stated in the thesis."""
    return match(
        image_mm,
        physical_mm,
        sigma_image_mm=per_axis_mm(IMAGE_SIGMA_MM, noise),
        sigma_physical_mm=per_axis_mm(PHYSICAL_SIGMA_MM, noise),
        expected=expected,
        prior=prior,
    )


def _satisfies_prior(plain: Match, prior: Array) -> bool:
    """Return whether the solution complies with a prior (3, 3), so that a second search is unnecessary.

    A prior only removes hypotheses. The best of all remains the best unless it is removed itself.
    """
    if plain.transform is None or plain.status is not MatchStatus.UNIQUE:
        return False
    return turn_rad(prior, plain.transform.as_matrix()[:3, :3]) <= DEFAULT_PRIOR_TOLERANCE_RAD
