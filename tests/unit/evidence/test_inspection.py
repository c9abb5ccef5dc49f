"""Every change to a run, of a byte or of a file, is found and named."""

import hashlib
import json
import os
import shutil
from collections.abc import Callable, Sequence
from itertools import combinations, islice
from pathlib import Path
from typing import Any

import pytest
from coded_errors import raises
from finished_runs import (
    changed_files,
    finished_run,
    seen,
    without_last_lines,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plain_steps import plain_order
from recording_cell import RecordingCell
from spoilt_runs import files_in, with_another_byte

from procedures.journal.journal import JOURNAL_FILE
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.journal_reading import RUN_CHANGED
from ronna_hw.evidence.manifest import (
    LASER_LINE_FILE,
    OWN_FOLDERS,
    REQUEST_FILE,
    SEAL_FILE,
    list_unchecked,
)
from ronna_hw.records import canonical_json


def test_an_unchanged_run_is_intact(finished: Path) -> None:
    assert inspect_run(finished).require_whole().problems == ()


@pytest.mark.hazard(39)
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_changed_byte_is_found(finished: Path, data: st.DataObject) -> None:
    path = data.draw(st.sampled_from(files_in(finished)))
    place = data.draw(st.integers(0, path.stat().st_size - 1))
    with with_another_byte(path, place, data.draw(st.integers(1, 255))):
        assert path.relative_to(finished).as_posix() in {one.file for one in inspect_run(finished).problems}
        with raises(RUN_CHANGED, match="PRO-033"):
            inspect_run(finished).require_whole()


@pytest.mark.slow
@pytest.mark.hazard(39)
@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_changed_byte_is_found_in_more_examples(finished: Path, data: st.DataObject) -> None:
    test_any_changed_byte_is_found.hypothesis.inner_test(finished, data)


@pytest.mark.hazard(39)
@pytest.mark.parametrize("name", ["empty", "records/empty", "theatre/a/b"])
def test_an_added_folder_is_named_although_it_is_empty(run: Path, name: str) -> None:
    (run / name).mkdir(parents=True)
    (problem,) = inspect_run(run).problems
    assert str(problem) == f"{name}: added: not part of the run"


def test_a_folder_that_a_run_made_and_never_filled_is_part_of_it(run: Path) -> None:
    for name in sorted(OWN_FOLDERS):
        (run / name).mkdir(exist_ok=True)
    assert inspect_run(run).problems == ()


@pytest.mark.hazard(39)
def test_any_missing_file_is_named(finished: Path, tmp_path: Path) -> None:
    for path in files_in(finished):
        aside = path.rename(tmp_path / "aside")
        try:
            named = {problem.file for problem in inspect_run(finished).problems}
            assert path.relative_to(finished).as_posix() in named
        finally:
            aside.rename(path)


@pytest.mark.hazard(39)
def test_any_two_swapped_files_are_named(run: Path) -> None:
    for one, other in islice(combinations(files_in(run), 2), 0, None, 4):
        contents = one.read_bytes(), other.read_bytes()
        one.write_bytes(contents[1])
        other.write_bytes(contents[0])
        named = {problem.file for problem in inspect_run(run).problems}
        exchanged = {path.relative_to(run).as_posix() for path in (one, other)}
        # Without journal and seal nothing can be said of the rest.
        assert (exchanged & {JOURNAL_FILE} or exchanged & {SEAL_FILE} or exchanged) <= named
        one.write_bytes(contents[0])
        other.write_bytes(contents[1])


@pytest.mark.parametrize("name", ["records/08-image.json", "pictures/more.png", "note.txt", "theatre/a/b"])
def test_any_added_file_is_named(run: Path, name: str) -> None:
    (run / name).parent.mkdir(parents=True, exist_ok=True)
    (run / name).write_text("from elsewhere")
    assert changed_files(run) == {name}


@pytest.mark.hazard(39)
@pytest.mark.parametrize("count", [1, 2, 5])
def test_removed_last_journal_lines_are_detected(run: Path, count: int) -> None:
    without_last_lines(run, count)
    assert JOURNAL_FILE in changed_files(run)


@pytest.mark.hazard(39)
def test_a_record_from_another_run_is_named(run: Path, tmp_path: Path) -> None:
    name = "records/02-localization-T1.json"
    shutil.copy(finished_run(tmp_path / "another") / name, run / name)
    what = " ".join(problem.what for problem in inspect_run(run).changes if problem.file == name)
    assert "not the record named in the journal" in what
    assert "is of run another" in what


def with_identifiers_exchanged(records: Sequence[dict[str, Any]]) -> None:
    one, other = records
    one["identifier"], other["identifier"] = other["identifier"], one["identifier"]


def with_another_date(records: Sequence[dict[str, Any]]) -> None:
    for record in records:
        record["created"] = f"1999{record['created'][4:]}"


@pytest.mark.hazard(39)
@pytest.mark.parametrize("hashed_anew", [False, True])
@pytest.mark.parametrize("change", [with_identifiers_exchanged, with_another_date])
def test_a_record_with_another_identifier_or_date_is_named(
    run: Path, change: Callable[[Sequence[dict[str, Any]]], None], hashed_anew: bool
) -> None:
    paths = sorted((run / "records").iterdir())[:2]
    records = [json.loads(path.read_bytes()) for path in paths]
    change(records)
    for path, record in zip(paths, records, strict=True):
        hashed = {key: value for key, value in record.items() if key not in ("sha256", "parents_sha256")}
        hashed["parents"] = dict(zip(record["parents"], record["parents_sha256"], strict=True))
        if hashed_anew:  # by someone who knows how
            record["sha256"] = hashlib.sha256(canonical_json(hashed)).hexdigest()
        path.write_text(json.dumps(record, indent=1))
    assert changed_files(run) == {path.relative_to(run).as_posix() for path in paths}


def test_repeating_a_step_keeps_the_pictures_of_its_earlier_runs(tmp_path: Path) -> None:
    cell = RecordingCell(tmp_path)
    order = plain_order("T1", image=seen)
    engine = cell.engine(order)
    for _ in range(3):
        engine.run_step(order.find("image"))
    engine.close("left")
    assert sorted(os.listdir(cell.folder / "pictures")) == ["ct-1-2.png", "ct-1-3.png", "ct-1.png"]
    assert inspect_run(cell.folder).changes == ()


@pytest.mark.hazard(39)
def test_a_renamed_run_is_refused(run: Path) -> None:
    assert {json.loads(path.read_text())["run"] for path in (run / "records").iterdir()} == {"run"}
    renamed = run.rename(run.with_name("another"))
    with raises(RUN_CHANGED, match="of run run, in a folder named another"):
        inspect_run(renamed).require_whole()


def test_a_run_beside_which_something_was_added_is_told_apart_from_a_changed_one(run: Path) -> None:
    renamed = run.rename(run.with_name("another"))
    with raises(RUN_CHANGED) as refused:
        inspect_run(renamed).require_whole()
    assert "rename the folder to run" in str(refused.value)
    assert "Do not rely" not in str(refused.value)


def test_a_renamed_run_is_called_unchanged_only_as_far_as_it_was_compared(run: Path) -> None:
    renamed = run.rename(run.with_name("another"))
    for every_file, compared in (
        (True, "What the run wrote: unchanged"),
        (False, "request and records: unch"),
    ):
        with raises(RUN_CHANGED, match=compared):
            inspect_run(renamed, every_file=every_file).require_unchanged()
    request = renamed / REQUEST_FILE
    request.write_text(request.read_text() + " ")
    with raises(RUN_CHANGED, match=r"request\.json: changed") as refused:
        inspect_run(renamed, every_file=False).require_unchanged()
    assert "unchanged" not in str(refused.value)


def test_a_laser_line_recorded_beside_the_baseline_later_is_named_and_no_added_file(run: Path) -> None:
    (run / LASER_LINE_FILE).write_text("{}")
    assert inspect_run(run).problems == ()
    assert list_unchecked(run) == [LASER_LINE_FILE]


def test_exports_are_not_part_of_the_run(run: Path) -> None:
    (run / "export").mkdir()
    (run / "export" / "spheres.csv").write_text("M1")
    assert inspect_run(run).problems == ()
