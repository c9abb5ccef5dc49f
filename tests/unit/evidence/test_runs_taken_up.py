"""Resuming a finished run or sending its arm home does not vouch for changed files."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from coded_errors import raises
from finished_runs import changed_files, gone_home, sealed, without_last_lines
from user_commands import in_this_process

from procedures.cli.procedure import app as ronna_procedure
from procedures.engine.run_folder import close_run
from procedures.journal.journal import JOURNAL_FILE, ONLY_LEAVING, Entry, Journal, JournalValue, read_journal
from procedures.runs.finishing import complete_seal, seal_run
from procedures.runs.interrupted_run import InterruptedRun, read_interrupted_run
from procedures.runs.reopening import prepare_folder
from ronna_hw.errors import EXIT_DONE, EXIT_REFUSED, EXIT_UNCONFIRMED
from ronna_hw.evidence.inspection import Problem, inspect_run
from ronna_hw.evidence.journal_reading import RUN_CHANGED, read_chain
from ronna_hw.evidence.manifest import SEAL_FILE, Manifest, is_sealed
from ronna_hw.evidence.unsealed import UNSEALED, describe_unsealed_files

READINGS = "readings.jsonl"
LATER = {"events.jsonl", "theatre/world.json"}


def renamed(run: Path) -> Path:
    return run.rename(run.with_name("another"))


def with_a_stray_file(run: Path) -> Path:
    (run / "notes.txt").write_text("mine")
    return run


def with_edited_readings(run: Path) -> Path:
    """A later session left them."""
    journal = Journal.reopen_run(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.RESTARTED, 0.0)
    (run / READINGS).write_text("as read")
    close_run(run, journal, 0.0, "done", None)
    sealed(run)
    (run / READINGS).write_text("edited")
    return run


def killed_on_its_way_home(run: Path) -> None:
    """What a `home` leaves that was killed before its end."""
    left = read_interrupted_run(run, only_leaving=True)
    journal = Journal.reopen_run(run, left.run.chain)
    journal.write(Entry.RESTARTED, 0.0, **left.as_plain())
    journal.close()


def finished_again(run: Path) -> None:
    """Complete a finished run that was killed before its seal, as `resume` does."""
    with complete_seal(read_interrupted_run(run)):
        pass


def resumed_and_killed_as_it_began(run: Path) -> InterruptedRun:
    """Leave a run as a `resume` does that was killed before its first line in the journal."""
    left = read_interrupted_run(run, only_leaving=True)
    prepare_folder(left)
    with (run / "log.jsonl").open("a") as log:
        log.write("opened again\n")
    (run / "theatre" / "world.json").write_text(f"after {(run / 'log.jsonl').stat().st_size} bytes")
    return left


def with_a_changed_picture(run: Path) -> Path:
    next((run / "pictures").iterdir()).write_bytes(b"another")
    return run


@pytest.mark.parametrize("spoil", [renamed, with_a_stray_file, with_a_changed_picture])
def test_a_change_outside_journal_and_records_passes_the_check_before_homing(
    run: Path, spoil: Callable[[Path], Path]
) -> None:
    found = inspect_run(spoil(run))
    with raises(RUN_CHANGED):
        found.require_unchanged()
    assert found.require_account().changes != ()


def test_homing_does_not_make_an_added_file_part_of_the_run(run: Path) -> None:
    stray = with_a_stray_file(run) / "notes.txt"
    for _ in range(2):
        gone_home(run)
        assert [problem.file for problem in inspect_run(run).problems] == ["notes.txt"]
    stray.unlink()
    assert inspect_run(run).problems == ()


def test_homing_does_not_vouch_for_a_changed_file(run: Path) -> None:
    plan = run / "case" / "plan.toml"
    as_it_was = plan.read_bytes()
    plan.write_bytes(b"schema = 2\n")
    for _ in range(2):
        gone_home(run)
        assert inspect_run(run).problems == (Problem("case/plan.toml", "changed"),)
    plan.write_bytes(as_it_was)
    assert inspect_run(run).problems == ()


@pytest.mark.hazard(39)
@pytest.mark.parametrize(
    ("spoil", "name"), [(with_a_stray_file, "notes.txt"), (with_edited_readings, READINGS)]
)
def test_a_session_that_was_killed_does_not_hide_what_it_found_changed(
    run: Path, spoil: Callable[[Path], Path], name: str
) -> None:
    spoil(run)
    for _ in range(2):
        killed_on_its_way_home(run)
        assert changed_files(run) == {name}
    gone_home(run)
    assert changed_files(run) == {name}
    (run / "notes.txt").unlink(missing_ok=True)
    if name == READINGS:
        (run / READINGS).write_text("as read")
    assert inspect_run(run).problems == ()


@pytest.mark.hazard(39)
def test_a_file_that_was_put_back_after_a_killed_session_is_as_it_was_left(run: Path) -> None:
    stray = with_a_stray_file(run) / "notes.txt"
    killed_on_its_way_home(run)
    stray.unlink()
    assert changed_files(run) == set()


@pytest.mark.hazard(39)
@pytest.mark.parametrize("name", [JOURNAL_FILE, "records/01-image.json"])
def test_a_changed_journal_or_record_fails_the_check_before_homing(run: Path, name: str) -> None:
    (run / name).write_bytes((run / name).read_bytes().replace(b"image", b"imagf"))
    with raises(RUN_CHANGED, match=name):
        inspect_run(run).require_account()


@pytest.mark.hazard(39)
def test_a_resumed_run_is_checked_against_its_first_end(run: Path) -> None:
    journal = Journal.reopen_run(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.RESTARTED, 1.0)
    journal.close()
    (run / "log.jsonl").write_text("goes on\n")
    assert changed_files(run) == set()
    (run / "case" / "plan.toml").write_text("another")
    assert changed_files(run) == {"case/plan.toml"}


def test_the_seal_of_an_earlier_end_does_not_cover_a_resumed_run(run: Path) -> None:
    files = Manifest(tuple(read_journal(run / JOURNAL_FILE))).files
    journal = Journal.reopen_run(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.RESTARTED, 1.0)
    journal.write(Entry.CLOSED, 2.0, outcome="done", files=files)
    journal.close()
    assert not is_sealed(run)
    assert [problem.file for problem in inspect_run(run).problems] == [SEAL_FILE]
    with raises(RUN_CHANGED, match="the last end was not sealed"):
        inspect_run(run).require_whole()
    sealed(run)
    assert inspect_run(run).problems == ()


def test_a_line_added_to_a_sealed_journal_is_detected(run: Path) -> None:
    journal = Journal.reopen_run(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.FINDING, 1.0, text="all is well")
    journal.close()
    assert changed_files(run) == {JOURNAL_FILE}


@pytest.mark.hazard(39)
@pytest.mark.parametrize(
    ("sealed_before", "lines_lost", "later_session", "also"),
    [
        (False, 1, gone_home, {*LATER, "theatre/truth.jsonl", "case/plan.toml"}),
        (False, 0, gone_home, LATER),
        (True, 0, gone_home, set()),
        (False, 0, finished_again, LATER),
    ],
    ids=["killed", "home without a seal", "home over a changed log", "resumed without a seal"],
)
def test_verify_names_what_a_later_session_sealed_as_it_lay(
    run: Path, sealed_before: bool, lines_lost: int, later_session: Callable[[Path], object], also: set[str]
) -> None:
    assert told_by_verify(run) == []
    if not sealed_before:
        (run / SEAL_FILE).unlink()
    if lines_lost:
        without_last_lines(run, lines_lost)
    (run / "log.jsonl").write_text("not what was logged\n")
    later_session(run)
    lines = tuple(read_journal(run / JOURNAL_FILE))
    (number,) = [one for one, line in enumerate(lines) if UNSEALED in line]
    assert lines[number][UNSEALED].keys() == {"log.jsonl", *also}
    (sentence,) = told_by_verify(run)
    assert "log.jsonl (20 bytes)" in sentence
    assert f"after line {number} of its journal" in sentence
    gone_home(run)  # from a seal on, which hides nothing of before
    assert told_by_verify(run) == [sentence]


@pytest.mark.hazard(39)
def test_taking_up_a_run_without_seal_and_last_line_makes_it_intact_only_as_far_as_can_be_said(
    run: Path,
) -> None:
    (run / SEAL_FILE).unlink()
    without_last_lines(run, 1)
    assert in_this_process(ronna_procedure, "verify", run).returncode == EXIT_REFUSED
    gone_home(run)
    assert in_this_process(ronna_procedure, "verify", run).returncode == EXIT_UNCONFIRMED


def test_the_sentence_about_what_lay_unsealed_counts_the_files_of_a_folder() -> None:
    files = {"log.jsonl": 9, "bytes/a": 1, "bytes/b": 2, "theatre/world.json": 3}
    (sentence,) = describe_unsealed_files(({"entry": Entry.RESTARTED, UNSEALED: files},))
    assert "log.jsonl (9 bytes), bytes (2 files), theatre/world.json (3 bytes) had no seal" in sentence


@pytest.mark.parametrize(
    ("line", "said"), [({}, "was resumed"), ({ONLY_LEAVING: True}, "was taken up, only to go home or to")]
)
def test_a_run_that_was_only_brought_home_is_not_called_resumed(
    line: dict[str, JournalValue], said: str
) -> None:
    (sentence,) = describe_unsealed_files(({"entry": Entry.RESTARTED, UNSEALED: {"log.jsonl": 9}, **line},))
    assert f"had no seal when the run {said}" in sentence


def told_by_verify(run: Path) -> list[str]:
    verified = in_this_process(ronna_procedure, "verify", run, "--json")
    said = json.loads(verified.stdout)
    code = EXIT_UNCONFIRMED if said["not_vouched_for"] else EXIT_DONE
    assert (verified.returncode, said["whole"]) == (code, True), said
    shown = in_this_process(ronna_procedure, "verify", run)
    assert shown.returncode == code
    first, *sentences = shown.stdout.splitlines()
    assert sentences == said["not_vouched_for"]
    assert ("intact as far as can be said" in first) == bool(sentences)
    assert first.endswith("as they lay when it was taken up again") == bool(sentences)
    return list(said["not_vouched_for"])


@pytest.mark.hazard(39)
def test_a_resume_that_is_killed_as_it_begins_can_be_repeated(run: Path) -> None:
    for _ in range(2):
        resumed_and_killed_as_it_began(run)
        found = inspect_run(run)
        assert {problem.file for problem in found.problems} == {"log.jsonl", "theatre/world.json"}
        assert found.changes == ()
        assert read_interrupted_run(run).unsealed.keys() == {"log.jsonl", "theatre/world.json"}
    gone_home(run)
    assert inspect_run(run).problems == ()
    (sentence,) = told_by_verify(run)
    assert "log.jsonl" in sentence


@pytest.mark.hazard(39)
def test_a_killed_resume_excuses_nobody_elses_changes(run: Path) -> None:
    (run / "log.jsonl").write_text("not what was logged\n")
    resumed_and_killed_as_it_began(run)
    assert changed_files(run) == {"log.jsonl"}
    (run / "case" / "plan.toml").write_text("another")
    (run / "theatre" / "theatre.toml.copy").write_text("added")
    next((run / "pictures").iterdir()).write_bytes(b"another")
    (run / "report" / "targets.csv").write_text("better")
    changed = {"log.jsonl", "case/plan.toml", "pictures/ct-1.png", "report/targets.csv"}
    assert changed_files(run) == {*changed, "theatre/theatre.toml.copy"}


@pytest.mark.hazard(39)
def test_a_resume_that_ends_itself_as_it_begins_leaves_the_run_sealed(run: Path) -> None:
    seal_run(run, resumed_and_killed_as_it_began(run))
    assert inspect_run(run).problems == ()
    resumed_and_killed_as_it_began(run)
    seal_run(run, resumed_and_killed_as_it_began(run))
    found = inspect_run(run)
    assert (found.changes, len(found.problems)) == ((), 2)  # it does not vouch for what the killed one left
