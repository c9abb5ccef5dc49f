"""Changes made after a kill are distinguished from what a kill can leave behind."""

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from finished_runs import changed_files
from run_again import lose_lines

from procedures.journal.journal import JOURNAL_FILE, Entry, Journal
from procedures.reporting.run_reading import read_for_report
from procedures.runs.interrupted_run import read_interrupted_run
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE, find_lost_lines
from ronna_hw.evidence.manifest import SEAL_FILE, hash_truth_files
from ronna_hw.evidence.unsealed import describe_unsealed_files
from ronna_hw.records import read_record, write_record


def other_date(folder: Path) -> None:
    path = folder / "records" / "02-localization-T1.json"
    record = read_record(path)
    path.unlink()
    write_record(replace(record, created="2020-01-01T00:00:00.000+00:00"), path.parent)


def exchanged_identifiers(folder: Path) -> None:
    path = folder / "records" / "02-localization-T1.json"
    path.write_text(path.read_text().replace("02-localization", "03-localization"))


def other_request(folder: Path) -> None:
    (folder / "request.json").write_text('{"seed": 4}')


def other_picture(folder: Path) -> None:
    (folder / "pictures" / "ct-1.png").write_bytes(b"of somebody else")


def link_to_the_same(folder: Path) -> None:
    path = folder / "pictures" / "ct-1.png"
    path.rename(folder.parent / "elsewhere.png")
    path.symlink_to(folder.parent / "elsewhere.png")


def pipe(folder: Path) -> None:
    path = folder / "pictures" / "ct-1.png"
    path.unlink()
    os.mkfifo(path)


SPOILED = {
    other_date: "records/02-localization-T1.json",
    exchanged_identifiers: "records/02-localization-T1.json",
    other_request: "request.json",
    other_picture: "pictures/ct-1.png",
    link_to_the_same: "pictures/ct-1.png",
    pipe: "pictures/ct-1.png",
}


@pytest.mark.hazard(39)
@pytest.mark.parametrize("left", [b"", bytes(4096)], ids=["empty", "zeros"])
def test_a_journal_without_a_line_beside_records_is_no_trace_of_a_kill(killed: Path, left: bytes) -> None:
    (killed / JOURNAL_FILE).write_bytes(left)
    assert JOURNAL_FILE in changed_files(killed)


@pytest.mark.hazard(39)
@pytest.mark.parametrize("spoil", SPOILED, ids=lambda spoil: spoil.__name__)
def test_changes_after_a_kill_are_distinguished_from_the_traces_of_the_kill(
    killed: Path, spoil: Callable[[Path], None]
) -> None:
    assert changed_files(killed) == set()
    assert [problem.what.partition(":")[0] for problem in inspect_run(killed).problems] == ["not closed"]
    spoil(killed)
    assert changed_files(killed) == {SPOILED[spoil]}


@pytest.mark.hazard(44)
def test_lines_that_only_the_event_file_still_has_are_named_until_the_run_is_resumed(killed: Path) -> None:
    lost = lose_lines(killed, from_line_with=b'"record":"02-localization-T1"')
    journal, number = killed / JOURNAL_FILE, len(read_chain(killed / JOURNAL_FILE).lines)
    first = f"has lost its end: events.jsonl has {len(lost)} more lines after line {number}, until 2"
    assert first in " ".join(problem.what for problem in inspect_run(killed).problems)
    reading = read_for_report(killed, every_file=False)
    assert first in reading.problems[0]
    assert "records that the journal does not name" in reading.problems[1].lower()
    left = read_interrupted_run(killed)
    assert not left.untouched
    again = Journal.reopen_run(killed, left.run.chain)  # by a program whose events were not written
    again.write(Entry.RESTARTED, 0.0, **left.as_plain())
    again.close()
    assert inspect_run(killed).lost == ()
    said, _ = describe_unsealed_files(read_chain(journal).lines)
    assert f"had lost {len(lost)} lines when the run was resumed after its line {number}" in said


@pytest.mark.hazard(44)
def test_the_event_file_of_another_run_or_of_the_same_lines_says_nothing_about_lost_lines(
    killed: Path,
) -> None:
    lose_lines(killed, from_line_with=b'"record":"02-localization-T1"')
    events, lines = (killed / EVENTS_FILE).read_bytes(), read_chain(killed / JOURNAL_FILE).lines
    assert find_lost_lines(events, lines)
    assert find_lost_lines(events.replace(b'"previous":"', b'"previous":"0'), lines) == ()
    assert find_lost_lines(b"".join(events.splitlines(keepends=True)[: len(lines)]), lines) == ()
    assert find_lost_lines(b'{"journal"\n' + events[:-9], lines)  # torn


@pytest.mark.hazard(39)
def test_the_truth_is_protected_once_the_run_is_closed_even_without_a_seal(run: Path) -> None:
    (run / SEAL_FILE).unlink()
    assert changed_files(run) == set()
    (run / "theatre" / "truth.jsonl").write_text("elsewhere\n")
    (run / "records" / "99-image.json").write_text("{}")
    assert changed_files(run) == {"theatre/truth.jsonl", "records/99-image.json"}


@pytest.fixture
def sampled(tmp_path: Path) -> Path:
    """A run that was killed after a sample of the truth had been taken, and a result was written."""
    folder = tmp_path / "run"
    (folder / "theatre").mkdir(parents=True)
    scene, truth = (folder / "theatre" / name for name in ("scene.json", "truth.jsonl"))
    scene.write_text("where everything is\n")
    journal = Journal(folder)
    journal.write(Entry.OPENED, 0.0, run=folder.name, **hash_truth_files(folder))
    journal.write(Entry.INTENT, 1.0, step="at_target:T1")
    truth.write_text("where the tip was\n")
    assert changed_files(folder) == set()  # killed at its target
    journal.write(Entry.FOUND, 2.0, **hash_truth_files(folder))
    journal.close()
    assert changed_files(folder) == set()
    return folder


@pytest.mark.hazard(39)
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("scene.json", "where nothing is\n"),
        ("truth.jsonl", "where the tip was not\n"),
        ("truth.jsonl", ""),
        ("truth.jsonl", None),
        ("truth.jsonl", "where the tip was\nand where it is wanted\n"),
    ],
    ids=["scene", "sample", "emptied", "gone", "added"],
)
def test_truth_replaced_in_a_killed_run_is_named(sampled: Path, name: str, content: str | None) -> None:
    path = sampled / "theatre" / name
    path.unlink()
    if content is not None:
        path.write_text(content)
    assert changed_files(sampled) == {f"theatre/{name}"}


def test_a_journal_that_claims_a_huge_truth_file_costs_no_memory(sampled: Path) -> None:
    journal = Journal.reopen_run(sampled, read_chain(sampled / JOURNAL_FILE))
    journal.write(Entry.FOUND, 3.0, truth={"theatre/truth.jsonl": [10**18, "0"]})
    journal.close()
    assert changed_files(sampled) == {"theatre/truth.jsonl"}
