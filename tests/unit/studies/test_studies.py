"""Studies: the same numbers on any workers, resumable, and never mixed in one folder."""

from __future__ import annotations

import hashlib
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bounded_cost import bounded_cost
from coded_errors import raises

from procedures.registration.correspondence import Prior
from studies.campaign import folder as study_folder
from studies.campaign.folder import FILE, Ledger, code, publish
from studies.campaign.study import Study, Table, Unit, add_up, blocks, generator
from studies.campaign.workers import run_study
from studies.correspondence import study as study_module
from studies.correspondence.outcomes import FALSE, PART, UNSUCCESSFUL, outcome_key, verdict
from studies.correspondence.study import CorrespondenceStudy, StudiedMatching
from studies.correspondence.tables import Series, outcomes_by_series, plot_figure_13, plots, tables
from studies.errors import EXTRA_MISSING, LEDGER_UNREADABLE, OTHER_STUDY, SCHEDULER_UNREACHABLE, UNIT_FAILED
from studies.heads import NoiseReading, draw_noise, draw_readings, sites_mm
from studies.registration import RegistrationStudy
from studies.strategies.study import ANY_SIDE, TRIALS, StrategiesStudy

SMALL = CorrespondenceStudy(4, seed=5, fiducials=(3, 5))
NO_SETTINGS = '{"study": "correspondence", "fingerprint": "another", "settings": %s}'


@dataclass(frozen=True)
class Failing(Study):
    """A study whose second unit fails while `broken` exists."""

    broken: str
    name: str = "failing"

    def units(self) -> list[Unit]:
        return blocks("cell", 3, 1)

    def run(self, unit: Unit) -> dict[str, float]:
        if unit.block == 1 and Path(self.broken).exists():
            raise ValueError("no luck")
        return {"runs": 1.0, "sum": float(generator(1, unit).normal())}


def results(study, folder: Path, **where: object) -> dict[str, dict[str, float]]:
    ledger = Ledger(folder, study)
    run_study(study, ledger, **where)
    return add_up(ledger.results())


@pytest.mark.slow
def test_one_process_and_a_pool_of_two_give_the_same_numbers(tmp_path: Path) -> None:
    study = RegistrationStudy(10, seed=5, fiducials=(3,))
    assert results(study, tmp_path / "1", workers=1) == results(study, tmp_path / "2", workers=2)


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a Dask scheduler with two workers."""
    from distributed import LocalCluster

    here = "127.0.0.1:0"  # any free port: with None the scheduler's HTTP server warns where 8787 is taken
    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=here, host="127.0.0.1"
    ) as cluster:
        yield cluster.scheduler_address


@pytest.mark.slow
def test_two_workers_of_a_dask_scheduler_give_the_same_numbers(scheduler: str, tmp_path: Path) -> None:
    spread = results(SMALL, tmp_path / "dask", scheduler=scheduler)
    assert spread == results(SMALL, tmp_path / "here", workers=1)


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_arms_and_strategies_have_the_same_errors_on_dask_workers(scheduler: str, tmp_path: Path) -> None:
    study = StrategiesStudy(arms=2)
    tried = (f"{TRIALS}|free|1", f"{ANY_SIDE}|free|2", f"{ANY_SIDE}|free|3")
    found = []
    for folder, where in (("dask", {"scheduler": scheduler}), ("here", {"workers": 1})):
        ledger = Ledger(tmp_path / folder, study)
        for unit in ledger.missing():
            if unit.condition not in tried:
                ledger.add(unit, {})
        found.append(results(study, tmp_path / folder, **where))
    assert found[0] == found[1]
    assert all(found[0][condition] for condition in tried)


def test_an_unreachable_scheduler_is_reported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("studies.campaign.workers.SCHEDULER_LIMIT_S", 0.2)
    with raises(SCHEDULER_UNREACHABLE, match="STU-003"):
        results(SMALL, tmp_path, scheduler="tcp://127.0.0.1:9")


def test_without_dask_a_scheduler_cannot_be_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with raises(EXTRA_MISSING, match="STU-004"):
        results(SMALL, tmp_path, scheduler="tcp://127.0.0.1:1")


@pytest.mark.parametrize(
    "address", ["nonsense", "tcp://", "http://127.0.0.1:8786", "tcp://127.0.0.1:99999", ""]
)
def test_an_invalid_scheduler_address_is_refused_before_dask_sees_it(address: str, tmp_path: Path) -> None:
    with raises(SCHEDULER_UNREACHABLE, match="STU-003: not an address"):
        results(SMALL, tmp_path, scheduler=address)


def test_a_failed_study_keeps_its_finished_units_and_resumes(tmp_path: Path) -> None:
    broken = tmp_path / "broken"
    broken.touch()
    study = Failing(str(broken))
    with raises(UNIT_FAILED, match="STU-005: cell #1: no luck"):
        results(study, tmp_path / "out", workers=1)
    assert len(Ledger(tmp_path / "out", study).finished) == 1
    broken.unlink()
    assert results(study, tmp_path / "out", workers=1) == results(study, tmp_path / "whole", workers=1)


def test_a_unit_whose_line_was_truncated_is_run_again(tmp_path: Path) -> None:
    whole = results(SMALL, tmp_path, workers=1)
    path = tmp_path / FILE
    path.write_bytes(path.read_bytes()[:-20])
    ledger = Ledger(tmp_path, SMALL)
    assert len(ledger.missing()) == 1
    run_study(SMALL, ledger, workers=1)
    assert add_up(ledger.results()) == whole
    assert not Ledger(tmp_path, SMALL).missing()


def test_a_folder_with_another_study_is_refused(tmp_path: Path) -> None:
    Ledger(tmp_path, SMALL)
    with raises(OTHER_STUDY, match=r"STU-001: .* other settings: runs 4, now 5"):
        Ledger(tmp_path, CorrespondenceStudy(5, seed=5, fiducials=(3, 5)))


def test_results_of_other_code_are_not_added_to(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Ledger(tmp_path, SMALL)
    monkeypatch.setattr("studies.campaign.folder.code", lambda: "other")
    with raises(OTHER_STUDY, match=r"STU-001: .* results of other code: .*[0-9a-f]{16}, now other"):
        Ledger(tmp_path, SMALL)


def test_the_hash_of_the_code_covers_every_package_that_results_depend_on() -> None:
    root = Path(study_folder.studies.__file__).parents[1]
    covered = {file.relative_to(root).parts[0] for file in study_folder.source_files(root)}
    assert covered == {"procedures", "ronna_hw", "sim", "studies"}
    assert Path(study_folder.__file__) in study_folder.source_files(root)
    assert hashlib.sha256().hexdigest()[:16] not in code()  # of nothing


@pytest.mark.parametrize(
    "damage", [lambda line: line[:-9], lambda line: line.replace('"runs": 1.0', '"runs": 2.0')]
)
def test_a_damaged_or_altered_line_loses_only_its_own_unit(
    tmp_path: Path, damage: Callable[[str], str]
) -> None:
    ledger = Ledger(tmp_path, SMALL)
    for unit in ledger.missing():
        ledger.add(unit, {"runs": 1.0})
    file = tmp_path / FILE
    head, first, *others = file.read_text().splitlines()
    file.write_text("\n".join([head, damage(first), *others, ""]))
    opened = Ledger(tmp_path, SMALL)
    assert (opened.damaged, len(opened.missing())) == (1, 1)
    assert Ledger(tmp_path, SMALL).damaged == 0


def test_a_ledger_with_too_many_damaged_lines_is_refused_quickly(tmp_path: Path) -> None:
    Ledger(tmp_path, SMALL)
    with (tmp_path / FILE).open("ab") as file:
        file.write(b"\n" * 3_000_000)
    with bounded_cost(limit_s=2.0), raises(LEDGER_UNREADABLE, match=r"STU-002: .*more than 1000 lines"):
        Ledger(tmp_path, SMALL)


@pytest.mark.parametrize("line", [{"unit": ["a"], "sums": {}}, {"unit": "a #0", "sums": {"runs": "many"}}])
def test_a_line_that_is_not_a_unit_is_ignored_even_with_a_valid_hash(
    tmp_path: Path, line: dict[str, Any]
) -> None:
    Ledger(tmp_path, SMALL)
    said = json.dumps([line["unit"], line["sums"]], sort_keys=True).encode()
    with (tmp_path / FILE).open("a") as file:
        file.write(json.dumps(line | {"sha256": hashlib.sha256(said).hexdigest()}) + "\n")
    opened = Ledger(tmp_path, SMALL)
    assert (opened.damaged, opened.finished) == (1, {})


@pytest.mark.parametrize("first", ["tea", "[1]", *(NO_SETTINGS % value for value in ("null", '"tea"'))])
def test_a_damaged_ledger_header_is_refused(tmp_path: Path, first: str) -> None:
    Ledger(tmp_path, SMALL)
    (tmp_path / FILE).write_text(f"{first}\n")
    with raises(LEDGER_UNREADABLE, match="STU-002"):
        Ledger(tmp_path, SMALL)


@pytest.mark.slow
def test_ours_and_the_thesis_method_are_counted_on_the_same_runs(tmp_path: Path) -> None:
    sums = results(SMALL, tmp_path, workers=1)
    found = outcomes_by_series(sums)
    assert {series.method for series in found} == {one.value for one in StudiedMatching}
    assert {one.runs for one in found.values()} == {4 * 3 * 5}  # runs, patients, numbers of outliers
    pictures = plots(sums) | plot_figure_13(sums)
    assert sorted(pictures) == [
        f"{what}-{noise}.png" for what in ("figure-13", "unsuccessful") for noise in ("norm", "per-axis")
    ]
    assert all(png.startswith(b"\x89PNG") for png in pictures.values())
    five = found[Series(NoiseReading.PER_AXIS, StudiedMatching.CLIQUE.value, "", 5)]
    assert five.count(*UNSUCCESSFUL, FALSE) == 0
    assert [table.title for table in tables(sums)] == [
        "Correspondence, noise per axis",
        "Correspondence, noise norm",
        "Five to eight fiducials together",
        "The values of e at which the thesis' figures come out",
    ]


def test_a_partial_pairing_counts_as_unsuccessful_and_a_wrong_pair_as_false() -> None:
    right = frozenset({(0, 2), (1, 0), (2, 1), (3, 3)})
    for outcome, pairs in (
        ("success", [(0, 2), (1, 0), (2, 1), (3, 3)]),
        ("part", [(0, 2), (1, 0), (2, 1)]),
        ("false", [(0, 0), (1, 2), (2, 1), (3, 3)]),
        ("false", [(0, 2), (1, 0), (2, 1), (3, 3), (4, 4)]),
    ):
        assert verdict(np.array(pairs), right) == outcome
    key = outcome_key(StudiedMatching.VALIDATED, 2.5, "part")
    lost = outcome_key(StudiedMatching.VALIDATED, 2.5, "success")
    sums = {"norm|1|5|0": {key: 1.0, lost: 3.0}}
    ((_, found),) = outcomes_by_series(sums).items()
    assert [found.percent(*one).value for one in (UNSUCCESSFUL, (FALSE,), (PART,))] == [25.0, 0.0, 25.0]


def test_the_values_of_e_that_reproduce_the_thesis_are_reported_as_ranges() -> None:
    sums = {
        f"norm|1|4|{outliers}": {
            outcome_key(StudiedMatching.VALIDATED, e, outcome): number
            for e, lost in ((1.4, 46.0), (1.5, 40.0), (1.6, 30.0), (3.0, 45.0))
            for outcome, number in (("success", 1000.0 - lost), ("lost", lost))
        }
        for outliers in range(5)
    }
    *_, reached = tables(sums)
    assert [row[2:] for row in reached.rows] == [["4", "1.4-1.5, 3", "1.4-3"]]


def test_a_prior_leaves_answers_that_agree_with_it_unchanged() -> None:
    seen = draw_readings(sites_mm(1), 3, 2, NoiseReading.PER_AXIS, 60, np.random.default_rng(8))
    changed = 0
    for image, physical, truth in zip(seen.image_mm, seen.physical_mm, seen.rotations, strict=True):
        plain = study_module.pair_points(image, physical, NoiseReading.PER_AXIS)
        anew = study_module.pair_points(image, physical, NoiseReading.PER_AXIS, prior=Prior(truth))
        if study_module._satisfies_prior(plain, truth.as_matrix()):
            assert (anew.status, anew.pairs.tolist()) == (plain.status, plain.pairs.tolist())
        else:
            changed += 1
    assert 0 < changed < 30


def test_readings_are_shuffled_pairs_in_one_pose() -> None:
    seen = draw_readings(sites_mm(2), 4, 3, NoiseReading.NORM, 20, np.random.default_rng(9))
    assert seen.image_mm.shape == seen.physical_mm.shape == (20, 7, 3)
    for image, physical, pairs, truth in zip(
        seen.image_mm, seen.physical_mm, seen.pairs, seen.rotations, strict=True
    ):
        turned = truth.apply(image[pairs[:, 0]])
        shift = physical[pairs[:, 1]] - turned
        assert np.abs(shift - shift.mean(axis=0)).max() < 3.0
    assert len({tuple(one[:, 0].tolist()) for one in seen.pairs}) > 10


def test_the_numbers_of_a_cell_do_not_depend_on_the_other_cells() -> None:
    unit = Unit("norm|2|5|1", 0, 4)
    assert SMALL.run(unit) == CorrespondenceStudy(4, seed=5).run(unit)


def test_both_readings_of_the_noise_have_their_stated_size() -> None:
    random = np.random.default_rng(1)
    per_axis = draw_noise((20_000, 3), 0.56, NoiseReading.PER_AXIS, random)
    norm = draw_noise((20_000, 3), 0.56, NoiseReading.NORM, random)
    assert per_axis.std() == pytest.approx(0.56, rel=0.02)
    assert np.sqrt((norm**2).sum(axis=1).mean()) == pytest.approx(0.56, rel=0.02)


def test_heads_differ_and_their_marker_sites_keep_their_distance() -> None:
    heads = [sites_mm(patient) for patient in (1, 2, 3)]
    assert not np.allclose(heads[0], heads[1])
    for sites in heads:
        gaps = np.linalg.norm(sites[:, None] - sites[None], axis=2) + np.eye(8) * 1e3
        assert gaps.min() > 25.0


def test_a_study_is_published_as_text_table_and_data(tmp_path: Path) -> None:
    table = Table("How many", ("what", "value"), [("a", 1.23456), ("b", None)], "A note.")
    report = publish(tmp_path, "study", {"seed": 1}, [table], {"plot.png": b"png"})
    assert "| a | 1.235 |" in report.read_text()
    assert "![plot.png](plot.png)" in report.read_text()
    assert (tmp_path / "how-many.csv").read_text() == "what,value\na,1.23456\nb,\n"
    assert json.loads((tmp_path / "results.json").read_text())["code"] == code()


@pytest.mark.slow
def test_weighting_gains_as_much_as_the_goals_require(tmp_path: Path) -> None:
    from studies.registration import tables as of_registration

    formulas, gains = of_registration(results(RegistrationStudy(400, fiducials=(5,)), tmp_path, workers=1))
    ((_, _, fle_ratio, one_space_ratio, _, _, _, tre_ratio, _, _),) = formulas.rows
    assert fle_ratio == pytest.approx(1.0, abs=0.05)
    assert one_space_ratio == pytest.approx(1.0, abs=0.05)
    assert tre_ratio == pytest.approx(1.0, abs=0.08)
    assert [row[6] > least for row, least in zip(gains.rows, (20.0, 40.0), strict=True)] == [True, True]
