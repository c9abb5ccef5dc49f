"""The thesis' clinical pairing protocol (5.3.2): 17 localized scans of the x-shaped frame, 1,415 readings.

The scans are those of the localization study, each with a scale error, the patients' with a worse protocol.
The readings come from the simulated tracker under several conditions. The thesis' method
pairs the output of our copy of its localizer, our method that of ours. There are no strays.
"""

from __future__ import annotations

import hashlib
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from procedures.imaging.localizers import LOCALIZERS, Localizer
from procedures.registration.similarity_matrix import Counting, match_many_by_similarity
from procedures.registration.thesis_matching import validate_many
from procedures.registration.thesis_settings import THESIS_TOLERANCES_MM
from ronna_hw.arrays import Array
from studies.campaign import bounds
from studies.campaign.plots import Point, curves
from studies.campaign.study import Cell, Study, Sums, Table, Unit, as_sums, generator
from studies.correspondence.frame_readings import CONDITIONS, SPHERES
from studies.correspondence.outcomes import FALSE, LOST, OUTCOMES, SUCCESS, Pairs, outcome_key, outcome_of
from studies.correspondence.study import StudiedMatching, pair_points
from studies.heads import NoiseReading, variance_from_thesis_mm2
from studies.localization.phantom_scans import phantom_scan
from studies.localization.study import SEED_BOUND
from studies.localization.thesis_protocol import (
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

PHANTOM_SCANS = 5
# Phantoms and patients in turn, so that an interrupted study has some of both.
SCANS: tuple[ThesisScan, ...] = tuple(
    sorted(
        (scan for scan in THESIS_SCANS if scan.kind == PATIENT or scan.number <= PHANTOM_SCANS),
        key=lambda scan: (scan.number, scan.kind),
    )
)
PROTOCOLS = {PHANTOM: PROTOCOL, PATIENT: "poor"}  # of the CT: the thesis needs a larger e for its patients
# Values of e, mm, at which the thesis matches every reading: figures 14 and 15, as stated in the text.
THESIS_RANGES_MM = {PHANTOM: (1.8, 4.5), PATIENT: (2.5, 4.0)}
THESIS_READINGS = 1415
NOISE = NoiseReading.NORM  # the interpretation that reproduces the thesis' other figures


@dataclass(frozen=True)
class FrameSeries:
    """Key of a result: conditions of the readings, and how a cell counts; None for our method.

    Pairs of the thesis' matrix are validated or taken as it finds them.
    """

    conditions: str
    counting: Counting | None = None
    is_validated: bool = False

    def __str__(self) -> str:
        if self.counting is None:
            return f"{self.conditions}: {StudiedMatching.COUNT}"
        method = StudiedMatching.VALIDATED if self.is_validated else StudiedMatching.THESIS
        return f"{self.conditions}: {method}, counted {self.counting.value}"


@dataclass(frozen=True, eq=False)
class ClinicalStudy(Study):
    """Pairing of all readings (n, 4, 3), mm, by their conditions, with every scan, one unit per scan."""

    readings_mm: Mapping[str, Array]
    seed: int = 0
    name: str = "correspondence-xframe"

    def settings(self) -> dict[str, object]:
        return {
            "seed": self.seed,
            "readings": self._count,
            "readings_sha256": {
                name: hashlib.sha256(one.tobytes()).hexdigest() for name, one in self.readings_mm.items()
            },
            "scans": len(SCANS),
            "protocols": PROTOCOLS,
            "tolerances_mm": list(THESIS_TOLERANCES_MM),
        }

    @property
    def _count(self) -> int:
        return len(next(iter(self.readings_mm.values())))

    def units(self) -> Sequence[Unit]:
        return [Unit(scan.condition, 0, self._count) for scan in SCANS]

    def run(self, unit: Unit) -> Sums:
        """Count the outcomes of our method, and of the thesis' method for each e and counting."""
        (drawn,) = (scan for scan in SCANS if scan.condition == unit.condition)
        random = generator(self.seed, unit)
        seed = int(random.integers(SEED_BOUND))
        with phantom_scan(drawn.family, PROTOCOLS[drawn.kind], seed, FRAME, drawn.spheres) as scan:
            found = localize_scan(scan, (Localizer.OURS, Localizer.THESIS_SPHERE))
        (scale,) = draw_scale(random, 1)
        image = {method: one.frame_mm(scale) for method, one in found.items()}
        sums: Counter[str] = Counter()
        for conditions, readings_mm in self.readings_mm.items():
            seen_mm, rights = _shuffle(readings_mm, random)
            sums += _count_our_outcomes(conditions, image[LOCALIZERS[Localizer.OURS].method], seen_mm, rights)
            sums += _count_thesis_outcomes(
                conditions, image[LOCALIZERS[Localizer.THESIS_SPHERE].method], seen_mm, rights
            )
        return as_sums(sums)


def _count_our_outcomes(
    conditions: str, image_mm: Array | None, seen_mm: Array, rights: Sequence[Pairs]
) -> Counter[str]:
    series = str(FrameSeries(conditions))
    if image_mm is None:
        return Counter({outcome_key(series, None, LOST): len(seen_mm)})
    sums: Counter[str] = Counter()
    for one_mm, right in zip(seen_mm, rights, strict=True):
        found = pair_points(image_mm, one_mm, NOISE, expected=len(image_mm))
        sums[outcome_key(series, None, outcome_of(found, right))] += 1
    return sums


def _count_thesis_outcomes(
    conditions: str, image_mm: Array | None, seen_mm: Array, rights: Sequence[Pairs]
) -> Counter[str]:
    sums: Counter[str] = Counter()
    many = len(seen_mm)
    for tolerance_mm in THESIS_TOLERANCES_MM:
        for counting in Counting:
            raw, validated = (str(FrameSeries(conditions, counting, is_valid)) for is_valid in (False, True))
            if image_mm is None:
                for series in (raw, validated):
                    sums[outcome_key(series, tolerance_mm, LOST)] += many
                continue
            image = np.broadcast_to(image_mm, seen_mm.shape)
            found = match_many_by_similarity(image, seen_mm, np.full(many, tolerance_mm), SPHERES, counting)
            valid = validate_many(image, seen_mm, found, variance_from_thesis_mm2(NOISE))
            for series, answers in ((raw, found), (validated, valid)):
                for right, one in zip(rights, answers, strict=True):
                    sums[outcome_key(series, tolerance_mm, outcome_of(one, right))] += 1
    return sums


def _shuffle(readings_mm: Array, random: np.random.Generator) -> tuple[Array, list[Pairs]]:
    many, spheres = readings_mm.shape[:2]
    order = random.permuted(np.tile(np.arange(spheres), (many, 1)), axis=1)
    seen = np.take_along_axis(readings_mm, order[:, :, None], axis=1)
    return seen, [frozenset((int(i), j) for j, i in enumerate(one)) for one in order]


def tables(sums: Mapping[str, Sums]) -> list[Table]:
    """Tabulate our success, and the values of e with which the thesis' method pairs every reading."""
    apart_mm = np.diff(
        np.sort(np.linalg.norm(FRAME_MM[:, None] - FRAME_MM[None], axis=2)[np.triu_indices(SPHERES, 1)])
    )
    cells = [
        (conditions.name, kind)
        for conditions in CONDITIONS
        for kind in THESIS_RANGES_MM
        if _count(sums, kind, FrameSeries(conditions.name), "").total()
    ]
    ours: list[dict[str, Cell]] = []
    for name, kind in cells:
        counted = _count(sums, kind, FrameSeries(name), "")
        success = bounds.percent(counted[SUCCESS], counted.total())
        ours.append(
            {
                "readings by": name,
                "scans of": kind,
                "pairings": counted.total(),
                **bounds.cells("success %", success),
                "lost": counted[LOST],
                "false": counted[FALSE],
            }
        )
    thesis: list[dict[str, Cell]] = [
        {
            "readings by": name,
            "scans of": kind,
            "counted": counting.value,
            **_describe_tolerances(sums, kind, FrameSeries(name, counting), "as found"),
            **_describe_tolerances(sums, kind, FrameSeries(name, counting, is_validated=True), "validated"),
            "thesis: 100 % in": "{:g}-{:g}".format(*THESIS_RANGES_MM[kind]),
        }
        for name, kind in cells
        for counting in Counting
    ]
    return [
        Table.of("The x-shaped frame in scans and readings, ours", ours, bounds.NOTE),
        Table.of(
            "The x-shaped frame in scans and readings, the thesis' matrix",
            thesis,
            f"It reports 24,055 of 24,055 with 17 scans. The distances of this frame differ by at least "
            f"{apart_mm.min():.2f} mm, those of the thesis' frame by more than 4.5. Validation refuses one "
            f"correct pairing in a thousand.",
        ),
    ]


def _describe_tolerances(
    sums: Mapping[str, Sums], kind: str, series: FrameSeries, name: str
) -> dict[str, Cell]:
    """Return the best e, the values of e at which all readings are paired, and the largest false number."""
    against = {e: _count(sums, kind, series, f"{e}") for e in THESIS_TOLERANCES_MM}
    perfect = [e for e, one in against.items() if one[SUCCESS] == one.total()]
    best_mm = max(against, key=lambda e: against[e][SUCCESS])
    best = against[best_mm]
    return {
        f"{name}: best %": 100.0 * best[SUCCESS] / best.total(),
        f"{name}: not paired": best.total() - best[SUCCESS],
        f"{name}: at e mm": best_mm,
        f"{name}: 100 % in": f"{min(perfect):g}-{max(perfect):g}" if perfect else "none",
        f"{name}: most false": max(one[FALSE] for one in against.values()),
    }


def plots(sums: Mapping[str, Sums]) -> dict[str, bytes]:
    """Plot success against e for every condition: figure 14 for the phantom, 15 for the patients.

    Pairs as found, one picture for each counting.
    """
    pictures = {}
    for counting in Counting:
        for figure, kind in ((14, PHANTOM), (15, PATIENT)):
            lines: dict[str, list[Point]] = {}
            for conditions in CONDITIONS:
                series = FrameSeries(conditions.name, counting)
                lines[conditions.name] = success_against_tolerance(sums, kind, series)
            how = "once" if counting is Counting.ONE_TO_ONE else "any"
            pictures[f"figure-{figure}-{how}.png"] = curves(
                f"x-shaped frame, {kind}, distances counted {counting.value}",
                "e, mm",
                "success, %",
                lines,
                bands={"thesis: all matched": THESIS_RANGES_MM[kind]},
            )
    return pictures


def success_against_tolerance(sums: Mapping[str, Sums], kind: str, series: FrameSeries) -> list[Point]:
    """Return the success in per cent of one series by e (mm), for one kind of scan."""
    counts = [(e, _count(sums, kind, series, f"{e}")) for e in THESIS_TOLERANCES_MM]
    return [(e, 100.0 * one[SUCCESS] / one.total()) for e, one in counts if one.total()]


def _count(sums: Mapping[str, Sums], kind: str, series: FrameSeries, tolerance: str) -> Counter[str]:
    """Count the outcomes of a series at one e over the scans of one kind."""
    scans = [content for condition, content in sums.items() if condition.startswith(f"{kind}|")]
    return Counter(
        {
            outcome: sum(round(content.get(f"{series}|{tolerance}|{outcome}", 0)) for content in scans)
            for outcome in OUTCOMES
        }
    )
