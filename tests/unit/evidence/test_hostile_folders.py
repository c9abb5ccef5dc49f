"""Hostile files and folders in a run cost neither memory nor time and forge no line of output."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from bounded_cost import bounded_cost
from finished_runs import changed_files, gone_home
from recording_cell import RecordingCell

from procedures.journal.journal import JOURNAL_FILE, Entry
from procedures.runs.finishing import seal_run
from ronna_hw.evidence.inspection import MOST_NAMES, inspect_run
from ronna_hw.evidence.manifest import LARGEST_FILE_BYTES, NOT_AS_LEFT, SEAL_FILE, read_seal, sha256_of
from ronna_hw.records import Record, write_record

FRAMES = 400  # of the interpreter, which usually has 1,000: so deep a chain takes seconds to make and remove


@pytest.fixture
def chain_of_folders() -> Iterator[Callable[[Path], None]]:
    """Makes folders nested deeper than the interpreter has frames."""
    usual = sys.getrecursionlimit()
    sys.setrecursionlimit(FRAMES)
    made: list[Path] = []

    def make(folder: Path) -> None:
        made.append(folder)
        folder.mkdir()
        at = os.open(folder, os.O_RDONLY)
        for _ in range(FRAMES + 100):
            os.mkdir("d", dir_fd=at)
            inner = os.open("d", os.O_RDONLY, dir_fd=at)
            os.close(at)
            at = inner
        os.close(at)

    yield make
    sys.setrecursionlimit(usual)
    subprocess.run(["rm", "-rf", *made], check=True)  # pytest removes its folders by recursion


@pytest.mark.parametrize("where", ["", "report/", "theatre/"])
def test_an_endless_chain_of_folders_is_reported_as_added(
    run: Path, where: str, chain_of_folders: Callable[[Path], None]
) -> None:
    chain_of_folders(run / f"{where}deep")
    (problem,) = inspect_run(run).changes
    assert problem.file.startswith(f"{where}deep/")
    assert problem.beside
    gone_home(run)
    assert inspect_run(run).problems == (problem,)


@pytest.mark.parametrize("where", ["export", ".report.partial"])
def test_an_endless_chain_of_folders_that_is_not_part_of_the_run_is_ignored(
    run: Path, where: str, chain_of_folders: Callable[[Path], None]
) -> None:
    chain_of_folders(run / where)
    assert inspect_run(run).problems == ()


@pytest.mark.parametrize("size", [LARGEST_FILE_BYTES + 1, 300_000_000_000])
def test_an_oversized_file_is_reported_as_changed_by_its_size_alone(run: Path, size: int) -> None:
    os.truncate(run / "pictures" / "ct-1.png", size)
    (problem,) = inspect_run(run).problems
    assert str(problem) == "pictures/ct-1.png: changed: larger than any file of a run"


def test_what_claims_to_be_empty_is_hashed_only_so_far() -> None:
    with bounded_cost(10 << 20, 1.0), pytest.raises(OSError, match="File too large"):
        sha256_of(Path("/proc/self/pagemap"))  # hundreds of gigabytes


def test_inputs_elsewhere_are_hashed_up_to_a_limit_of_all_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ronna_hw.evidence.inspection.LARGEST_INPUTS_BYTES", 1000)
    files = [tmp_path / name for name in "abc"]
    for file in files:
        file.write_bytes(bytes(400))
    cell = RecordingCell(tmp_path / "run")
    cell.journal.write(Entry.CLOSED, 0.0, inputs={str(file): sha256_of(file) for file in files})
    named = [problem for problem in inspect_run(cell.folder).problems if problem.file == str(files[2])]
    assert [problem.what for problem in named] == ["not checked: too much lies outside the run"]


def test_an_added_folder_that_may_not_be_read_is_named(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (run / "hidden").mkdir()  # root may read every folder
    monkeypatch.setattr("ronna_hw.host.files.os.access", lambda path, _how: path.name != "hidden")
    assert changed_files(run) == {"hidden"}


def test_a_file_whose_name_is_not_valid_text_is_not_sealed(run: Path) -> None:
    (run / SEAL_FILE).unlink()
    (run / "report" / os.fsdecode(b"a\xff")).write_text("from elsewhere")
    seal_run(run)
    (problem,) = inspect_run(run).problems
    assert str(problem) == "report/a\\udcff: added: not part of the run"


def test_a_line_break_in_a_file_name_does_not_forge_a_line(run: Path) -> None:
    (run / "note\nwhole.json").write_text("from elsewhere")
    (problem,) = inspect_run(run).problems
    assert str(problem) == "note whole.json: added: not part of the run"


def test_a_seal_that_claims_a_huge_journal_costs_no_memory(run: Path) -> None:
    made = read_seal(run)
    assert made is not None
    longer = made.model_copy(update={"journal_bytes": 10**18}).with_own_hash()
    (run / SEAL_FILE).write_text(longer.model_dump_json(by_alias=True, indent=1))
    assert inspect_run(run).changes == ()  # of the same bytes, which are all there is
    (run / JOURNAL_FILE).write_bytes((run / JOURNAL_FILE).read_bytes() + b"\n")
    assert changed_files(run) == {JOURNAL_FILE}


def test_a_journal_line_of_endless_brackets_is_reported(run: Path) -> None:
    with (run / JOURNAL_FILE).open("ab") as journal:
        journal.write(b"[" * 100_000 + b"\n")
    assert changed_files(run) == {JOURNAL_FILE}


@pytest.mark.parametrize("name", ["9" * 300, "a\0b"], ids=["too long", "with a zero byte"])
def test_impossible_file_names_in_a_journal_are_reported(tmp_path: Path, name: str) -> None:
    cell = RecordingCell(tmp_path / "run")
    cell.journal.write(Entry.RESULT, 0.0, step="image", record=name, sha256="0", pictures={name: "0"})
    cell.journal.write(Entry.CLOSED, 0.0, files={name: "0"})
    wrong = {problem.file for problem in inspect_run(cell.folder).changes}
    assert wrong >= {f"records/{name}.json", f"pictures/{name}", name}


@pytest.mark.parametrize("name", ["../outside", "a/../../outside", "./outside", "{outside}"])
def test_a_file_outside_the_run_that_a_journal_names_is_reported_and_not_opened(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    outside = write_record(Record("outside", "image", {}, {}), tmp_path)
    name = name.format(outside=outside.with_suffix(""))
    cell = RecordingCell(tmp_path / "run")
    sha256 = sha256_of(outside)
    cell.journal.write(Entry.RESULT, 0.0, step="image", record=f"../{name}", sha256="0")
    cell.journal.write(Entry.RESULT, 0.0, step="image", record=name, sha256="0", pictures={name: sha256})
    cell.journal.write(Entry.CLOSED, 0.0, files={f"{name}.json": sha256})
    opened: list[Path] = []
    for where in ("inspection.read_record", "inspection.sha256_of"):
        monkeypatch.setattr(f"ronna_hw.evidence.{where}", opened.append)
    problems = {problem.file: problem.what for problem in inspect_run(cell.folder).changes}
    named = (f"records/../{name}.json", f"records/{name}.json", f"pictures/{name}", f"{name}.json")
    assert {problems[one] for one in named} == {"not the name of a file of the run"}
    assert opened == []


def test_a_record_that_a_journal_names_twice_is_reported_and_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = RecordingCell(tmp_path / "run")
    for _ in range(3):
        cell.journal.write(Entry.RESULT, 0.0, step="image", record="a", sha256="0")
    read: list[str] = []

    def reads(path: Path) -> Record:
        read.append(path.name)
        return Record("a", "image", {}, {})

    monkeypatch.setattr("ronna_hw.evidence.inspection.read_record", reads)
    assert "records/a.json: named twice" in map(str, inspect_run(cell.folder).changes)
    assert read == ["a.json"]


FIELDS = {"pictures": (Entry.CLOSED, ""), "inputs": (Entry.CLOSED, ""), NOT_AS_LEFT: (Entry.RESTARTED, None)}


@pytest.mark.parametrize(
    ("field", "count"),
    [
        pytest.param("pictures", 90_000, marks=pytest.mark.slow),
        ("pictures", 110_000),
        (NOT_AS_LEFT, 90_000),
        *(pytest.param(field, 500_000, marks=pytest.mark.slow) for field in FIELDS),
        pytest.param("inputs", 90_000, marks=pytest.mark.slow),
    ],
)
def test_a_journal_that_names_very_many_files_is_checked_at_bounded_cost(
    tmp_path: Path, field: str, count: int
) -> None:
    cell, (entry, sha256) = RecordingCell(tmp_path / "run"), FIELDS[field]
    cell.journal.write(entry, 0.0, **{field: {f"{number:x}": sha256 for number in range(count)}})
    for number in range(2000):
        (cell.folder / f"{number:x}").touch()
    with bounded_cost():
        problems = inspect_run(cell.folder).changes
    assert problems[0].what.startswith("names more than") == (count > MOST_NAMES)


@pytest.mark.parametrize("name", ["/a\0b", "/\ud800", "/" + "a" * 5000])
def test_an_input_elsewhere_with_an_impossible_name_is_reported(tmp_path: Path, name: str) -> None:
    cell = RecordingCell(tmp_path / "run")
    cell.journal.write(Entry.CLOSED, 0.0, inputs={name: "0" * 64})
    assert name in {problem.file for problem in inspect_run(cell.folder).changes}
