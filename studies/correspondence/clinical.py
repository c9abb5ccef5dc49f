"""The thesis' clinical protocol of pairing (5.3.2): 17 localized scans of the x-shaped frame, 1,415 readings.

The scans are those of the localization study, each with a scale error; the readings are from the simulated
tracker. The thesis' method pairs the output of our copy of its localizer, our method that of ours. No strays.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from procedures.registration.matching import match
from procedures.registration.similarity_matrix import (
    THESIS_TOLERANCES_MM,
    match_many_by_similarity,
    validate_many,
)
from studies.campaign import bounds
from studies.campaign.plots import curves
from studies.campaign.table import Cell, Table
from studies.campaign.unit import Sums, Unit, generator
from studies.correspondence.study import LOST, SUCCESS, Method, Pairs, outcome_key, verdict
from studies.heads import (
    IMAGE_SIGMA_MM,
    PHYSICAL_SIGMA_MM,
    NoiseReading,
    per_axis_mm,
    stated_variance_mm2,
)
from studies.localization.phantom_scans import phantom_scan
from studies.localization.study import SEED_BOUND
from studies.localization.study import Method as Localizer
from studies.localization.thesis_scans import (
    FRAME,
    FRAME_MM,
    PATIENT,
    PHANTOM,
    PROTOCOL,
    THESIS_SCANS,
    ThesisScan,
    draw_scale,
    localize_scan,
)

Array = NDArray[np.float64]

PHANTOM_SCANS = 5
SCANS: tuple[ThesisScan, ...] = tuple(
    scan for scan in THESIS_SCANS if scan.kind == PATIENT or scan.number <= PHANTOM_SCANS
)
# Values of e, mm, at which the thesis matches every reading: figures 14 and 15, as stated in the text.
THESIS_RANGES_MM = {PHANTOM: (1.8, 4.5), PATIENT: (2.5, 4.0)}
THESIS_READINGS = 1415
NOISE = NoiseReading.NORM  # the interpretation that reproduces the thesis' other figures


@dataclass(frozen=True, eq=False)
class ClinicalStudy:
    """Every reading (n, 4, 3), mm, against every scan; a unit per scan."""

    readings_mm: Array
    seed: int = 0
    name: str = "correspondence-xframe"

    def settings(self) -> dict[str, object]:
        """Everything the results depend on."""
        return {
            "seed": self.seed,
            "readings": len(self.readings_mm),
            "readings_sha256": hashlib.sha256(self.readings_mm.tobytes()).hexdigest(),
            "scans": len(SCANS),
            "tolerances_mm": list(THESIS_TOLERANCES_MM),
        }

    def units(self) -> Sequence[Unit]:
        """The scans in order."""
        return [Unit(scan.condition, 0, len(self.readings_mm)) for scan in SCANS]

    def run(self, unit: Unit) -> Sums:
        """Outcomes of our method, and of the thesis' for each e."""
        (drawn,) = (scan for scan in SCANS if scan.condition == unit.condition)
        random = generator(self.seed, unit)
        seed = int(random.integers(SEED_BOUND))
        with phantom_scan(drawn.family, PROTOCOL, seed, FRAME, drawn.spheres) as scan:
            found = localize_scan(scan)
        (scale,) = draw_scale(random, 1)
        image = {method: one.frame_mm(scale) for method, one in found.items()}
        sums = self._ours(image[Localizer.OURS], random) + self._by_thesis(
            image[Localizer.THESIS_SPHERE], random
        )
        return {key: float(value) for key, value in sums.items()}

    def _ours(self, image_mm: Array | None, random: np.random.Generator) -> Counter[str]:
        if image_mm is None:
            return Counter({outcome_key(Method.COUNT, None, LOST): len(self.readings_mm)})
        physical_mm, rights = self._shuffled(random)
        sums: Counter[str] = Counter()
        for seen_mm, right in zip(physical_mm, rights, strict=True):
            one = match(
                image_mm,
                seen_mm,
                sigma_image_mm=per_axis_mm(IMAGE_SIGMA_MM, NOISE),
                sigma_physical_mm=per_axis_mm(PHYSICAL_SIGMA_MM, NOISE),
                expected=len(image_mm),
            )
            sums[outcome_key(Method.COUNT, None, verdict(one.status, one.pairs, right))] += 1
        return sums

    def _by_thesis(self, image_mm: Array | None, random: np.random.Generator) -> Counter[str]:
        sums: Counter[str] = Counter()
        many = len(self.readings_mm)
        for tolerance_mm in THESIS_TOLERANCES_MM:
            if image_mm is None:
                sums[outcome_key(Method.VALIDATED, tolerance_mm, LOST)] += many
                continue
            physical_mm, rights = self._shuffled(random)
            image = np.broadcast_to(image_mm, physical_mm.shape)
            found = match_many_by_similarity(image, physical_mm, np.full(many, tolerance_mm))
            for right, one in zip(
                rights, validate_many(image, physical_mm, found, stated_variance_mm2(NOISE)), strict=True
            ):
                outcome = verdict(one.status, one.pairs, right)
                sums[outcome_key(Method.VALIDATED, tolerance_mm, outcome)] += 1
        return sums

    def _shuffled(self, random: np.random.Generator) -> tuple[Array, list[Pairs]]:
        """The readings in random order, and the correct pairs."""
        many, spheres = self.readings_mm.shape[:2]
        order = random.permuted(np.tile(np.arange(spheres), (many, 1)), axis=1)
        seen = np.take_along_axis(self.readings_mm, order[:, :, None], axis=1)
        return seen, [frozenset((int(i), j) for j, i in enumerate(one)) for one in order]


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Where the thesis' method pairs every reading, and how many ours pairs."""
    rows: list[Sequence[Cell]] = []
    for kind, (low, high) in THESIS_RANGES_MM.items():
        against = success_against_tolerance(sums, kind)
        if not against:
            continue
        runs, ours = _success(sums, kind, Method.COUNT, "")
        perfect = [e for e, share in against if share == 1.0]
        within = [share for e, share in against if low <= e <= high]
        rows.append(
            (
                kind,
                runs,
                100.0 * ours,
                bounds.percent(ours * runs, runs).text,
                100.0 * max(share for _, share in against),
                min(perfect, default=None),
                max(perfect, default=None),
                f"{low:g}-{high:g}",
                100.0 * min(within),
            )
        )
    apart_mm = np.diff(
        np.sort(np.linalg.norm(FRAME_MM[:, None] - FRAME_MM[None], axis=2)[np.triu_indices(4, 1)])
    )
    return [
        Table(
            "The x-shaped frame in scans and readings",
            (
                "scans of",
                "readings",
                "ours, success %",
                bounds.column("ours"),
                "thesis, validated: best %",
                "100 % from e mm",
                "100 % to e mm",
                "thesis: 100 % in",
                "least % there, here",
            ),
            rows,
            f"{len(SCANS)} scans; the thesis reports 24,055 of 24,055. The distances of this "
            f"frame differ by at least {apart_mm.min():.2f} mm, those of the thesis' frame by "
            f"more than 4.5. {bounds.NOTE}",
        )
    ]


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    """Success against e."""
    lines = {
        f"scans of {kind}s": [(e, 100.0 * share) for e, share in success_against_tolerance(sums, kind)]
        for kind in THESIS_RANGES_MM
    }
    bands = {f"thesis, {of}: all matched": ends for of, ends in THESIS_RANGES_MM.items()}
    picture = curves("x-shaped frame, the thesis' method", "e, mm", "success, %", lines, bands=bands)
    return {"success-against-e.png": picture}


def success_against_tolerance(sums: Mapping[str, Sums], kind: str) -> list[tuple[float, float]]:
    """Share of readings that the thesis' method, validated, pairs in scans of one kind, for every e in mm."""
    found = [(e, *_success(sums, kind, Method.VALIDATED, f"{e}")) for e in THESIS_TOLERANCES_MM]
    return [(e, share) for e, runs, share in found if runs]


def _success(sums: Mapping[str, Sums], kind: str, method: Method, tolerance: str) -> tuple[int, float]:
    runs, success = 0.0, 0.0
    for condition, content in sums.items():
        for key, number in content.items():
            if condition.startswith(kind) and key.startswith(f"{method.value}|{tolerance}|"):
                runs += number
                success += number if key.endswith(f"|{SUCCESS}") else 0.0
    return int(runs), success / runs if runs else 0.0
