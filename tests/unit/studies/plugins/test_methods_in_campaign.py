"""User methods in a campaign: versions, workers, failures; the same numbers on any workers."""

from __future__ import annotations

import sys
from multiprocessing import active_children
from pathlib import Path

import pytest
from coded_errors import raises

from studies.campaign.folder import Ledger
from studies.campaign.study import Sums, add_up
from studies.campaign.workers import SilenceWatch, run_study
from studies.correspondence.study import CorrespondenceStudy
from studies.errors import OTHER_STUDY, MethodFailed, MethodRefused
from studies.heads import NoiseReading
from studies.plugin_trial import try_plugin
from studies.plugins.contracts import MethodKind
from studies.plugins.method import PluginMethod, find_plugin, local_modules
from studies.registration import RegistrationStudy

PAIRING, REGISTRATION = MethodKind.PAIRING, MethodKind.REGISTRATION


def study_of(method: PluginMethod) -> CorrespondenceStudy:
    return CorrespondenceStudy(3, 5, (), readings=(NoiseReading.NORM,), fiducials=(4,), own=(method,))


def results(study: CorrespondenceStudy, folder: Path, **where: object) -> dict[str, Sums]:
    ledger = Ledger(folder, study)
    run_study(study, ledger, **where)
    return add_up(ledger.results())


@pytest.mark.slow
def test_random_numbers_of_a_method_do_not_depend_on_its_worker(folder: Path) -> None:
    study = study_of(try_plugin(PAIRING, "mine:in_order"))
    assert results(study, folder / "1", workers=1) == results(study, folder / "2", workers=2)


@pytest.mark.slow
def test_a_user_file_runs_on_dask_workers_in_another_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from distributed import LocalCluster

    study = study_of(try_plugin(PAIRING, "mine:in_order"))
    here = results(study, folder / "here", workers=1)
    elsewhere = folder / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)  # the workers cannot find the file by themselves
    monkeypatch.setattr(sys, "path", [one for one in sys.path if one != str(folder)])
    with LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address="127.0.0.1:0", host="127.0.0.1"
    ) as cluster:
        assert results(study, folder / "dask", scheduler=cluster.scheduler_address) == here


def test_an_edited_method_is_another_study_and_its_old_version_does_not_run(folder: Path) -> None:
    before = try_plugin(PAIRING, "mine:in_order")
    Ledger(folder / "out", study_of(before))
    (folder / "mine.py").write_text((folder / "mine.py").read_text().replace("[:3]", "[:4]"))
    with pytest.raises(MethodRefused, match="STU-012: mine:in_order is a different version here"):
        before.function()
    after = try_plugin(PAIRING, "mine:in_order")
    with raises(OTHER_STUDY, match=r"STU-001: .*own"):
        Ledger(folder / "out", study_of(after))


LAZY = """
def pair(image_mm, physical_mm, **given):
    from helping.pairs import first
    return first
"""


def test_local_imports_of_a_method_are_part_of_its_version(folder: Path) -> None:
    (folder / "lazy.py").write_text(LAZY)
    (folder / "stranger.py").write_text("")
    (folder / "helping").mkdir()
    (folder / "helping" / "__init__.py").write_text("from helping import pairs\n")
    pairs = folder / "helping" / "pairs.py"
    pairs.write_text("import numpy\nfirst = [(0, 0)]\n")
    before = find_plugin(PAIRING, "lazy:pair")
    assert set(local_modules(sys.modules["lazy"])) == {"lazy", "helping", "helping.pairs"}
    assert before.function()(None, None) == [(0, 0)]
    pairs.write_text("import numpy\nfirst = [(0, 0), (1, 1)]\n")
    with pytest.raises(MethodRefused, match="STU-012: lazy:pair is a different version here"):
        before.function()
    after = find_plugin(PAIRING, "lazy:pair")
    assert after.sha256 != before.sha256
    assert after.function()(None, None) == [(0, 0), (1, 1)]


def test_a_failure_during_a_run_names_the_method_and_the_unit(folder: Path) -> None:
    late = "def late(image_mm, physical_mm, **given):\n    return [] if len(image_mm) == 5 else 1 / 0\n"
    (folder / "late.py").write_text(late)
    study = study_of(try_plugin(PAIRING, "late:late"))
    with pytest.raises(MethodFailed, match=r"late raised ZeroDivisionError: .*, in unit norm\|1\|4\|0 #0: "):
        results(study, folder / "out", workers=1)


@pytest.mark.slow
def test_a_method_that_exits_during_a_run_is_reported_with_its_unit_and_finished_units_are_kept(
    folder: Path,
) -> None:
    gone = "import os\ndef gone(image_mm, physical_mm, **given):\n    return [] if %s else os._exit(0)\n"
    (folder / "gone.py").write_text(gone % "len(physical_mm) < 6")
    study = study_of(find_plugin(PAIRING, "gone:gone"))
    ledger = Ledger(folder / "out", study)
    with pytest.raises(MethodFailed, match=r"STU-013: gone:gone ended its process: .*, in norm\|1\|4\|2 #0"):
        run_study(study, ledger, workers=1)
    assert sorted(Ledger(folder / "out", study).finished) == ["norm|1|4|0 #0", "norm|1|4|1 #0"]


def test_a_hanging_method_is_reported_once_and_ends_with_the_campaign(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "loops.py").write_text("def loops(image_mm, physical_mm, **given):\n    while True: pass\n")
    study = study_of(find_plugin(PAIRING, "loops:loops"))
    monkeypatch.setattr(SilenceWatch.__init__, "__defaults__", (0.1,))
    said = []

    def interrupt_after_the_first(text: str) -> None:
        said.append(text)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(study, Ledger(folder / "out", study), workers=1, tell=interrupt_after_the_first)
    assert said == ["loops:loops has not answered for 0.1 s, in norm|1|4|0 #0; Ctrl-C stops it"]
    assert not active_children()


def test_a_user_registration_is_measured_on_the_same_points_as_ours(folder: Path) -> None:
    (folder / "same.py").write_text(
        "from procedures.registration.point_registration import register\n"
        "def same(image_mm, physical_mm, *, covariance_mm2):\n"
        "    return register(image_mm, physical_mm).transform\n"
    )
    study = RegistrationStudy(2, fiducials=(4,), own=(try_plugin(REGISTRATION, "same:same"),))
    sums = study.run(study.units()[0])
    assert sums["own same:same2"] == sums["tre2"]
