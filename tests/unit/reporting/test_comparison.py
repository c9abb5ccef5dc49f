"""Two runs beside each other: what differed before they began, and what came of it."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
from clinical_case import FIRST, ClinicalCell
from coded_errors import raises
from report_text import report_text
from user_commands import in_this_process, one_error

import procedures
from procedures.cli.procedure import app
from procedures.journal.journal import Entry
from procedures.reporting.comparison import differences
from procedures.reporting.comparison.page import compare_runs
from procedures.reporting.kept_truth import store_truth
from procedures.reporting.outcome import TargetTruth, Truth
from procedures.runs.folders import new_run_folder
from procedures.runs.request import CaseProcedure, RunRequest, SceneChoice
from ronna_hw.arguments import WrongArgument
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.evidence.journal_reading import JOURNAL_FILE
from ronna_hw.evidence.manifest import REQUEST_FILE, seal
from ronna_hw.loaded_run import load_run


def request_of(tmp_path: Path, seed: int, faults: str = "") -> str:
    script = None
    if faults:
        script = tmp_path / "faults.txt"
        script.write_text(faults)
    asked = RunRequest(procedure=CaseProcedure(), choice=SceneChoice("mini", seed), faults=script)
    return (new_run_folder(asked, tmp_path / "asked") / REQUEST_FILE).read_text()


@pytest.fixture
def pair(registered: Path, tmp_path: Path) -> tuple[Path, Path]:
    """A registered case with an error at its first target, and one that failed at once."""
    store_truth(registered, Truth(targets=(TargetTruth(id=FIRST, application_error_mm=0.25),)))
    (registered / REQUEST_FILE).write_text(request_of(tmp_path, 3))
    seal(registered, {})
    cell = ClinicalCell(tmp_path / "20261121T000000-s4-beef")
    cell.journal.write(Entry.OPENED, 0.0, theatre="mini scene, seed 4", strategy="nos", seed=4)
    cell.journal.write(Entry.INTENT, 0.0, step="ct_import", moves=False)
    cell.journal.write(Entry.FAILED, 1.5, step="ct_import", code="CT-001", what="CT-001: no slices")
    (cell.folder / REQUEST_FILE).write_text(request_of(tmp_path, 4, "at 2 s: room shift head +0 +1 +0 mm\n"))
    return registered, cell.folder


def test_what_differed_before_they_began_is_listed_and_the_rest_is_counted(pair: tuple[Path, Path]) -> None:
    options = next(one for one in compare_runs(*pair).differences if one.title == "Options")
    found = {row.name: (row.first, row.second) for row in options.rows}
    assert found == {
        "seed": ("3", "4"),
        "strategy": ("ocs", "nos"),
        "fault lines": (differences.NOT_SET, "at 2 s: room shift head +0 +1 +0 mm"),
    }
    assert options.compared > len(found)
    assert compare_runs(pair[0], pair[0]).differences[0].gist.startswith("all ")


def test_no_folder_of_a_case_is_named_on_the_page(pair: tuple[Path, Path], tmp_path: Path) -> None:
    request = pair[1] / REQUEST_FILE
    content = json.loads(request.read_text()) | {"case": "/cases/Miller", "plan": "/cases/Miller/plan.toml"}
    request.write_text(json.dumps(content))
    page = compare_runs(*pair).write(tmp_path / "comparison.html")
    assert "Miller" not in page.read_text()


def test_steps_targets_and_findings_of_both_stand_beside_each_other(pair: tuple[Path, Path]) -> None:
    compared = compare_runs(*pair)
    steps = {one.name: one for one in compared.steps}
    assert steps["ct_import"].ended == ("done", "failed")
    assert steps["ct_import"].theatre_s.second == 1.5
    assert steps["plan_check"].ended.second == "not reached"
    assert steps["plan_check"].longer_s is None
    first = compared.targets[0]
    assert (first.name, first.error_mm) == (FIRST, (0.25, None))
    assert first.limit_mm.second is None
    assert any("no slices" in text for text in compared.findings.only_second)
    assert compared.registrations[0].apart_mm is None


def test_a_run_beside_itself_has_its_target_in_the_same_place(pair: tuple[Path, Path]) -> None:
    registered = compare_runs(pair[0], pair[0]).registrations[0]
    assert registered.apart_mm == registered.turned_deg == 0.0
    assert compare_runs(pair[0], pair[0]).plan_pictures == ()


def test_the_page_says_how_each_ended_and_fetches_nothing(pair: tuple[Path, Path], tmp_path: Path) -> None:
    page = tmp_path / "comparison.html"
    done = in_this_process(app, "compare", *pair, "--out", page)
    assert done.stdout == f"{page}\n"
    text = report_text(page)
    assert "A: 20261120T000000-s3-abcd" in text
    assert "CT-001" in text
    assert "0.250" in text
    assert "<script" not in page.read_text()
    assert "accuracy" not in text


def test_a_page_that_takes_the_place_of_another_says_so(pair: tuple[Path, Path], tmp_path: Path) -> None:
    said = [
        in_this_process(app, "compare", *pair, "--out", tmp_path / "comparison.html").stderr for _ in "ab"
    ]
    assert ["has been replaced" in one for one in said] == [False, True]


def test_steps_have_their_titles_and_runs_of_two_cts_a_banner(
    pair: tuple[Path, Path], tmp_path: Path
) -> None:
    compared = compare_runs(*pair)
    text = report_text(compared.write(tmp_path / "comparison.html"))
    assert "Import the CT series" in text
    assert "two different CTs" not in text  # that of the second is not known
    assert "two different CTs" in report_text(
        replace(compared, has_two_cts=True).write(tmp_path / "comparison.html")
    )


def test_a_notebook_shows_both_endings_and_the_errors_with_their_units(pair: tuple[Path, Path]) -> None:
    shown = compare_runs(*pair)._repr_html_()
    assert "<th>error mm A</th>" in shown
    assert "<td>0.25</td>" in shown
    assert "B: 20261121T000000-s4-beef" in shown


def test_a_page_that_is_not_html_is_refused_with_how_to_print(
    pair: tuple[Path, Path], tmp_path: Path
) -> None:
    refused = in_this_process(app, "compare", *pair, "--out", tmp_path / "comparison.pdf")
    assert "print it on A4, or to a PDF" in one_error(refused.stderr)[0]
    assert not (tmp_path / "comparison.pdf").exists()


def test_a_name_without_a_suffix_is_a_folder_for_the_page(pair: tuple[Path, Path], tmp_path: Path) -> None:
    in_this_process(app, "compare", *pair, "--out", tmp_path / "both")
    assert [one.suffix for one in (tmp_path / "both").iterdir()] == [".html"]


def test_a_folder_that_is_no_run_is_refused_from_python_too(pair: tuple[Path, Path], tmp_path: Path) -> None:
    with raises(PATH_PROBLEM, match="not the folder of a run"):
        procedures.compare_runs(pair[0], tmp_path / "none")
    with raises(WrongArgument):
        procedures.compare_runs(pair[0], "")


def test_a_run_beside_itself_is_refused(pair: tuple[Path, Path]) -> None:
    with raises(PATH_PROBLEM, match="both are the run"):
        procedures.compare_runs(pair[0], load_run(pair[0]))
    refused = in_this_process(app, "compare", pair[0], pair[0])
    assert "both are the run" in one_error(refused.stderr)[0]


def test_no_page_from_python_is_written_over_a_run(pair: tuple[Path, Path], tmp_path: Path) -> None:
    compared = procedures.compare_runs(*pair)
    kept = (pair[0] / JOURNAL_FILE).read_bytes()
    with raises(WrongArgument, match="ends in .html"):
        compared.write(pair[0] / JOURNAL_FILE)
    with raises(PATH_PROBLEM, match="inside the run"):
        compared.write(pair[0] / "comparison.html")
    assert (pair[0] / JOURNAL_FILE).read_bytes() == kept
    assert compared.write(str(tmp_path / "comparison.html")).exists()


def test_a_page_inside_a_run_is_refused(pair: tuple[Path, Path]) -> None:
    refused = in_this_process(app, "compare", *pair, "--out", pair[0] / "comparison.html")
    assert "CLI-005" in refused.stderr
    shutil.rmtree(pair[1])
    refused = in_this_process(app, "compare", *pair)
    assert "is not the folder of a run" in one_error(refused.stderr)[0]
