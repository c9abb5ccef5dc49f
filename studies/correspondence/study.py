"""The thesis' correspondence protocol: 3 patients, 3 to 8 fiducials, 0 to 4 outliers, both noise models.

Each method solves every run on the same points.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from itertools import product

import numpy as np
from scipy.spatial.transform import Rotation

from procedures.registration.correspondence import (
    DEFAULT_PRIOR_TOLERANCE_RAD,
    Match,
    MatchStatus,
    Prior,
    turn_rad,
)
from procedures.registration.gradual_matrix import match_many_gradually
from procedures.registration.matching import match
from procedures.registration.similarity_matrix import SimilarityPairs, match_many_by_similarity
from procedures.registration.thesis_matching import validate_many
from procedures.registration.thesis_settings import REFUSED_SHARE
from ronna_hw.arrays import Array
from studies.campaign.study import Study, Sums, Unit, as_sums, blocks_of_each, generator
from studies.correspondence.outcomes import LOST, Pairs, outcome_key, outcome_of, pair_set, verdict
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

FIDUCIALS = tuple(range(3, 9))
OUTLIERS = tuple(range(5))
BLOCK_RUNS = 500
PRIOR_DISTURBED_RAD = math.radians(20.0)  # largest error of the orientation given as a prior
# The first brings the thesis' method closest to its figures for 3 and 4 markers, the second ours of its
# matrix to those of 5 to 8.
USUAL_TOLERANCES_MM = (1.5, 2.5)


class StudiedMatching(StrEnum):
    """Our method, alone or with prior knowledge from the plan; the thesis' and our gradual matrix.

    Each matrix comes raw and validated. That of the thesis is told the number of markers.
    """

    CLIQUE = "clique"
    PRIOR = "clique + orientation"
    COUNT = "clique + planned count"
    THESIS = "thesis"
    VALIDATED = "thesis, validated"
    GRADUAL = "gradual matrix"
    GRADUAL_VALIDATED = "gradual matrix, validated"


OURS = (StudiedMatching.CLIQUE, StudiedMatching.PRIOR, StudiedMatching.COUNT)
# Raw and validated method of each matrix.
WRITTEN = (StudiedMatching.THESIS, StudiedMatching.VALIDATED)
GRADUAL = (StudiedMatching.GRADUAL, StudiedMatching.GRADUAL_VALIDATED)
SWEPT = (StudiedMatching.VALIDATED, StudiedMatching.GRADUAL_VALIDATED)


@dataclass(frozen=True)
class CorrespondenceStudy(Study):
    """Correspondence study with `runs` per condition, and every e in `tolerances_mm` for both matrices.

    Their validation refuses `refused_share` of the correct pairings.
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

    def units(self) -> Sequence[Unit]:
        cells = product(self.readings, PATIENTS, self.fiducials, OUTLIERS)
        return blocks_of_each(cells, self.runs, BLOCK_RUNS)

    def run(self, unit: Unit) -> Sums:
        """Count the outcomes of every method, keyed `method|e|outcome`."""
        reading, patient, count, outliers = condition_of(unit.condition)
        random = generator(self.seed, unit)
        seen = draw_readings(sites_mm(patient), count, outliers, reading, unit.runs, random)
        tilts = Rotation.from_rotvec(uniform_in_ball(unit.runs, PRIOR_DISTURBED_RAD, random))
        priors = tilts * seen.rotations
        prior_matrices = np.asarray(priors.as_matrix())
        rights = [pair_set(one) for one in seen.pairs]
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
                    sums[outcome_key(method, None, outcome_of(found, right))] += 1
        sums += self._count_matrix_outcomes(seen, rights, reading, count)
        for own in self.own:
            sums += _count_plugin_outcomes(PluginPairing.of(own), seen, rights, reading)
        return as_sums(sums)

    def _count_matrix_outcomes(
        self, seen: Readings, rights: Sequence[Pairs], noise: NoiseReading, markers: int
    ) -> Counter[str]:
        """Count the outcomes of both matrices for every e, before and after the validation."""
        sums: Counter[str] = Counter()
        chosen = set(self.methods)
        variance_mm2 = variance_from_thesis_mm2(noise)
        for tolerance_mm in self.tolerances_mm:
            everywhere = np.full(len(seen), tolerance_mm)
            answers: dict[StudiedMatching, tuple[SimilarityPairs, ...]] = {}
            if chosen & set(WRITTEN):
                answers[StudiedMatching.THESIS] = match_many_by_similarity(
                    seen.image_mm, seen.physical_mm, everywhere, markers
                )
            if chosen & set(GRADUAL):
                answers[StudiedMatching.GRADUAL] = match_many_gradually(
                    seen.image_mm, seen.physical_mm, everywhere
                )
            for raw, validated in (WRITTEN, GRADUAL):
                if validated in chosen:
                    answers[validated] = validate_many(
                        seen.image_mm, seen.physical_mm, answers[raw], variance_mm2, self.refused_share
                    )
            for method in answers.keys() & chosen:
                for right, one in zip(rights, answers[method], strict=True):
                    sums[outcome_key(method, tolerance_mm, outcome_of(one, right))] += 1
        return sums


def _count_plugin_outcomes(
    pairing: PluginPairing, seen: Readings, rights: Sequence[Pairs], noise: NoiseReading
) -> Counter[str]:
    sums: Counter[str] = Counter()
    for image_mm, physical_mm, right in zip(seen.image_mm, seen.physical_mm, rights, strict=True):
        found = pairing(image_mm, physical_mm, **stated_sigmas_mm(noise))
        sums[outcome_key(pairing.name, None, LOST if found is None else verdict(found, right))] += 1
    return sums


def condition_of(key: str) -> tuple[NoiseReading, int, int, int]:
    reading, patient, fiducials, outliers = key.split("|")
    return NoiseReading(reading), int(patient), int(fiducials), int(outliers)


def stated_sigmas_mm(noise: NoiseReading, factor: float = 1.0) -> dict[str, float]:
    """Return the errors per axis that the thesis states, times a factor, as a pairing is told them."""
    return {
        "sigma_image_mm": factor * per_axis_mm(IMAGE_SIGMA_MM, noise),
        "sigma_physical_mm": factor * per_axis_mm(PHYSICAL_SIGMA_MM, noise),
    }


def pair_points(
    image_mm: Array,
    physical_mm: Array,
    noise: NoiseReading,
    expected: int | None = None,
    prior: Prior | None = None,
) -> Match:
    """Pair by our method, assuming the errors stated in the thesis."""
    return match(image_mm, physical_mm, **stated_sigmas_mm(noise), expected=expected, prior=prior)


def _satisfies_prior(plain: Match, prior: Array) -> bool:
    """Return whether the solution complies with a prior (3, 3), so that a second search is unnecessary.

    A prior only removes hypotheses. The best of all remains the best unless it is removed itself.
    """
    if plain.transform is None or plain.status is not MatchStatus.UNIQUE:
        return False
    return turn_rad(prior, plain.transform.as_matrix()[:3, :3]) <= DEFAULT_PRIOR_TOLERANCE_RAD
