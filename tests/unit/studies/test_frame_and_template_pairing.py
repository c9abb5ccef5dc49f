"""Pairing by the clinical protocol, for every e, and of markers that a template places."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from scipy.spatial.transform import Rotation

from procedures.registration.correspondence import MatchStatus
from procedures.registration.similarity_matrix import Counting, match_many_by_similarity
from studies.campaign.study import Unit
from studies.correspondence import clinical, frame_readings, template
from studies.correspondence.clinical import SCANS, THESIS_RANGES_MM, ClinicalStudy
from studies.correspondence.frame_readings import CONDITIONS, SPECTRA_STILL, ReadingConditions
from studies.correspondence.template import MARGIN_MM, TemplateStudy, sites_mm
from studies.errors import LEDGER_UNREADABLE, OTHER_STUDY, TRACKER_NOT_SIMULATED
from studies.heads import NoiseReading
from studies.localization.study import AUTOMATIC
from studies.localization.thesis_protocol import FRAME_MM, PATIENT, PHANTOM, LocalizedScan


def readings(count: int, sigma_mm: float = 0.15) -> np.ndarray:
    random = np.random.default_rng(4)
    turned = [Rotation.random(rng=random).apply(FRAME_MM) for _ in range(count)]
    return np.array(turned) + random.normal(size=(count, 4, 3)) * sigma_mm


@pytest.fixture
def found_by_all(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every method finds the frame's spheres, in another order, and one more."""
    centres = np.vstack([FRAME_MM[[2, 0, 3, 1]], [[10.0, 20.0, 120.0]]])

    monkeypatch.setattr(clinical, "phantom_scan", lambda *_: nullcontext())
    found = {method: LocalizedScan(centres, 1.0) for method in AUTOMATIC}
    monkeypatch.setattr(clinical, "localize_scan", lambda *_: found)


def test_the_distances_of_the_close_frame_differ_by_little_more_than_the_largest_e() -> None:
    apart = np.linalg.norm(FRAME_MM[:, None] - FRAME_MM[None], axis=2)[np.triu_indices(4, 1)]
    _, largest_e = THESIS_RANGES_MM[PHANTOM]
    assert largest_e < np.diff(np.sort(apart)).min() < largest_e + 0.1


@pytest.mark.slow
def test_seventeen_scans_pair_every_reading_of_each_condition(found_by_all: None) -> None:
    kinds = {kind: sum(scan.kind == kind for scan in SCANS) for kind in (PHANTOM, PATIENT)}
    assert kinds == {PHANTOM: 5, PATIENT: 12}
    study = ClinicalStudy({one.name: readings(40) for one in CONDITIONS})
    sums = {kind: study.run(Unit(f"{kind}|1", 0, 40)) for kind in kinds}
    ours, thesis = clinical.tables({f"{kind}|1": one for kind, one in sums.items()})
    assert [row[2:4] for row in ours.rows] == [(40, 100.0)] * len(CONDITIONS) * len(kinds)
    assert len(thesis.rows) == len(CONDITIONS) * len(kinds) * len(Counting)
    for row in thesis.rows:
        shown = dict(zip(thesis.columns, row, strict=True))
        assert (shown["as found: best %"], shown["validated: best %"]) == (100.0, 100.0)
        from_mm, to_mm = map(float, shown["as found: 100 % in"].split("-"))
        assert from_mm < to_mm


def test_success_ends_at_the_most_similar_distances_only_where_a_distance_counts_with_any_counterpart() -> (
    None
):
    random = np.random.default_rng(5)
    seen = readings(60)
    image = np.broadcast_to(FRAME_MM, seen.shape) + random.normal(size=seen.shape) * 0.1

    def success(e_mm: float, counting: Counting) -> float:
        found = match_many_by_similarity(image, seen, np.full(len(seen), e_mm), 4, counting)
        right = [
            one.status is MatchStatus.UNIQUE and np.all(one.pairs[:, 0] == one.pairs[:, 1]) for one in found
        ]
        return float(np.mean(right))

    for counting in Counting:
        assert success(2.5, counting) == 1.0
    assert success(6.0, Counting.ONE_TO_ONE) == 1.0
    assert success(4.4, Counting.ANY) > 0.5 > success(5.0, Counting.ANY)


def test_a_reading_with_two_spheres_swapped_counts_as_a_false_pairing(found_by_all: None) -> None:
    exchanged = readings(5)[:, [1, 0, 2, 3]]
    sums = ClinicalStudy({SPECTRA_STILL.name: exchanged}).run(Unit(f"{PHANTOM}|1", 0, 5))
    assert (
        sums["Spectra, still: clique + planned count||false"] == 5
    )  # told so, because the record's order says otherwise


def test_a_unit_that_never_sees_the_whole_frame_is_refused() -> None:
    with raises(TRACKER_NOT_SIMULATED, match="STU-008"):
        frame_readings._take_whole_reading(lambda _: np.zeros((0, 3)), True, np.random.default_rng(1))


def test_readings_are_cached_in_the_folder_and_those_of_another_study_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken = readings(3)
    monkeypatch.setattr(frame_readings, "take_readings", lambda *_: taken)
    for _ in ("taken", "stored"):
        found = frame_readings.load_or_take_readings(tmp_path, 3, 1)
        assert list(found) == [one.name for one in CONDITIONS]
        assert all(np.array_equal(one, taken) for one in found.values())
    with raises(OTHER_STUDY, match="STU-001"):
        frame_readings.load_or_take_readings(tmp_path, 3, 2)
    for content, error in (
        ('{"seed": 1, "readings_mm": {"Spectra, still": 5}}', OTHER_STUDY),
        ('{"seed": 1, "readings_mm": 5}', LEDGER_UNREADABLE),
        ("{}", LEDGER_UNREADABLE),
    ):
        (tmp_path / frame_readings.READINGS_FILE).write_text(content)
        with raises(error):
            frame_readings.load_or_take_readings(tmp_path, 3, 1)


@pytest.mark.slow
@pytest.mark.timeout(120)
@pytest.mark.parametrize("conditions", CONDITIONS, ids=[one.name for one in CONDITIONS])
def test_the_simulated_unit_reads_the_frame_over_its_wire(conditions: ReadingConditions) -> None:
    (seen,) = frame_readings.take_readings(conditions, 1, seed=2)
    expected = np.linalg.norm(FRAME_MM[:, None] - FRAME_MM[None], axis=2)
    assert np.linalg.norm(seen[:, None] - seen[None], axis=2) == pytest.approx(expected, abs=4.0)
    assert -2600.0 < seen[:, 2].mean() < -850.0


def test_the_marker_distances_of_every_head_differ_by_the_margin() -> None:
    for patient in (1, 2, 3):
        for count in (3, 4):
            sites = sites_mm(patient, count, MARGIN_MM)
            apart = np.linalg.norm(sites[:, None] - sites[None], axis=2)[np.triu_indices(count, 1)]
            assert np.diff(np.sort(apart)).min() >= MARGIN_MM


def test_four_markers_by_a_template_are_paired_among_four_outliers() -> None:
    condition = f"{NoiseReading.PER_AXIS}|1|4|4"
    sums = TemplateStudy(20, seed=3).run(Unit(condition, 0, 20))
    methods = ("distances", "+ planned count", "template", "template + orientation")
    assert sums == {f"{method}|success": 20.0 for method in methods}
    (said,) = template.tables({condition: sums})
    assert [row[3:] for row in said.rows] == [
        (20, 0.0, "at most 14", "0-0", 0.0, "at most 14", "yes", "yes")
    ] * 4
