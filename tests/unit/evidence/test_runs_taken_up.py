"""Resuming a finished run or sending its arm home does not vouch for changed files."""

from collections.abc import Callable
from pathlib import Path

import pytest
from finished_runs import changed_files, gone_home, sealed

from procedures.engine.closing import close_run
from procedures.engine.left_run import read_left_run
from procedures.journal.journal import JOURNAL_FILE, Entry, Journal, read_journal
from ronna_hw.evidence.errors import RunChanged
from ronna_hw.evidence.inspection import Problem, closed_files, inspected
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.evidence.seal import SEAL_FILE, is_sealed

READINGS = "readings.jsonl"


def renamed(run: Path) -> Path:
    return run.rename(run.with_name("another"))


def with_a_stray_file(run: Path) -> Path:
    (run / "notes.txt").write_text("mine")
    return run


def with_edited_readings(run: Path) -> Path:
    """A later session left them."""
    journal = Journal.taken_up(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.RESTARTED, 0.0)
    (run / READINGS).write_text("as read")
    close_run(run, journal, 0.0, "done", None)
    sealed(run)
    (run / READINGS).write_text("edited")
    return run


def killed_on_its_way_home(run: Path) -> None:
    """What a `home` leaves that was killed before its end."""
    left = read_left_run(run, only_leaving=True)
    journal = Journal.taken_up(run, left.chain)
    journal.write(Entry.RESTARTED, 0.0, **left.as_plain())
    journal.close()


def with_a_changed_picture(run: Path) -> Path:
    next((run / "pictures").iterdir()).write_bytes(b"another")
    return run


@pytest.mark.parametrize("spoil", [renamed, with_a_stray_file, with_a_changed_picture])
def test_a_change_outside_journal_and_records_passes_the_check_before_homing(
    run: Path, spoil: Callable[[Path], Path]
) -> None:
    found = inspected(spoil(run))
    with pytest.raises(RunChanged):
        found.require_unchanged()
    assert found.require_account().changes != ()


def test_homing_does_not_make_an_added_file_part_of_the_run(run: Path) -> None:
    stray = with_a_stray_file(run) / "notes.txt"
    for _ in range(2):
        gone_home(run)
        assert [problem.file for problem in inspected(run).problems] == ["notes.txt"]
    stray.unlink()
    assert inspected(run).problems == ()


def test_homing_does_not_vouch_for_a_changed_file(run: Path) -> None:
    plan = run / "case" / "plan.toml"
    as_it_was = plan.read_bytes()
    plan.write_bytes(b"schema = 2\n")
    for _ in range(2):
        gone_home(run)
        assert inspected(run).problems == (Problem("case/plan.toml", "changed"),)
    plan.write_bytes(as_it_was)
    assert inspected(run).problems == ()


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
    assert inspected(run).problems == ()


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
    with pytest.raises(RunChanged, match=name):
        inspected(run).require_account()


@pytest.mark.hazard(39)
def test_a_resumed_run_is_checked_against_its_first_end(run: Path) -> None:
    journal = Journal.taken_up(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.RESTARTED, 1.0)
    journal.close()
    (run / "log.jsonl").write_text("goes on\n")
    assert changed_files(run) == set()
    (run / "case" / "plan.toml").write_text("another")
    assert changed_files(run) == {"case/plan.toml"}


def test_the_seal_of_an_earlier_end_does_not_cover_a_resumed_run(run: Path) -> None:
    files = closed_files(tuple(read_journal(run / JOURNAL_FILE)))
    journal = Journal.taken_up(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.RESTARTED, 1.0)
    journal.write(Entry.CLOSED, 2.0, outcome="done", files=files)
    journal.close()
    assert not is_sealed(run)
    assert [problem.file for problem in inspected(run).problems] == [SEAL_FILE]
    with pytest.raises(RunChanged, match="the last end was not sealed"):
        inspected(run).require_whole()
    sealed(run)
    assert inspected(run).problems == ()


def test_a_line_added_to_a_sealed_journal_is_detected(run: Path) -> None:
    journal = Journal.taken_up(run, read_chain(run / JOURNAL_FILE))
    journal.write(Entry.FINDING, 1.0, text="all is well")
    journal.close()
    assert changed_files(run) == {JOURNAL_FILE}
