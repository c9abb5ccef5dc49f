import errno
import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from procedures.journal.errors import JournalNotWritable
from procedures.journal.journal import BLOCK_BYTES, JOURNAL_FILE, Entry, Journal, read_journal
from ronna_hw.evidence.journal_reading import JournalCorrupt, read_chain
from ronna_hw.evidence.manifest import ROOM_FILE


def _written(folder: Path) -> Path:
    journal = Journal(folder)
    journal.write(Entry.INTENT, 1.0, step="ct_import")
    journal.write(Entry.RESULT, 2.0, step="ct_import", record="01-ct_import")
    journal.close()
    return folder / JOURNAL_FILE


def test_entries_are_read_back_in_order(tmp_path: Path) -> None:
    lines = list(read_journal(_written(tmp_path)))
    assert [(line["sequence"], line["entry"]) for line in lines] == [(0, "intent"), (1, "result")]


@pytest.mark.hazard(39)
@pytest.mark.hazard(1)
@pytest.mark.parametrize(
    "damage",
    [
        lambda text: text.replace('"theatre_time_s":1.0', '"theatre_time_s":9.0'),
        lambda text: text.splitlines(keepends=True)[1],
    ],
    ids=["altered", "missing"],
)
def test_an_altered_or_missing_line_breaks_the_chain(tmp_path: Path, damage: Callable[[str], str]) -> None:
    path = _written(tmp_path)
    path.write_text(damage(path.read_text()))
    with pytest.raises(JournalCorrupt, match="PRO-011"):
        list(read_journal(path))


def test_a_torn_last_line_is_ignored(tmp_path: Path) -> None:
    path = _written(tmp_path)
    path.write_text(path.read_text() + json.dumps({"sequence": 2})[:7])
    assert len(list(read_journal(path))) == 2


@pytest.mark.hazard(2)
@pytest.mark.parametrize("entry", [Entry.RESULT, Entry.INSTRUMENT])
@pytest.mark.parametrize("following", [1, 30])
def test_an_emptied_last_block_costs_no_result_that_other_lines_follow(
    tmp_path: Path, entry: Entry, following: int
) -> None:
    journal = Journal(tmp_path)
    journal.write(Entry.INTENT, 1.0, step="ct_import")
    journal.write(entry, 2.0)
    for number in range(following):
        journal.write(Entry.FINDING, 3.0, text=f"number {number}")
    journal.close()
    path = tmp_path / JOURNAL_FILE
    content = path.read_bytes()
    kept = (len(content) - 1) // BLOCK_BYTES * BLOCK_BYTES
    path.write_bytes(content[:kept] + bytes(len(content) - kept))
    chain = read_chain(path)
    assert chain.lines[1]["entry"] == entry
    assert chain.torn


@pytest.mark.hazard(33)
def test_a_journal_is_neither_overwritten_nor_opened_in_a_missing_folder(tmp_path: Path) -> None:
    _written(tmp_path)
    for folder in (tmp_path, tmp_path / "missing"):
        with pytest.raises(JournalNotWritable, match="PRO-003"):
            Journal(folder)


@pytest.mark.hazard(33)
def test_a_full_disk_is_reported_when_writing_an_entry(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    os.dup2(full := os.open("/dev/full", os.O_WRONLY), journal._file)
    os.close(full)
    with pytest.raises(JournalNotWritable, match="No space left"):
        journal.write(Entry.INTENT, 0.0)


@pytest.mark.hazard(33)
def test_a_deleted_journal_takes_no_line_and_one_that_was_moved_does(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    folder.mkdir()
    journal = Journal(folder)
    folder = folder.rename(tmp_path / "elsewhere")
    journal.write(Entry.OPENED, 0.0)
    shutil.rmtree(folder)
    with pytest.raises(JournalNotWritable, match=r"PRO-053: the run folder .*/run was deleted"):
        journal.write(Entry.INTENT, 1.0)


@pytest.mark.parametrize("moment", ["write", "fdatasync", "fstat"])
@pytest.mark.parametrize("done", [False, True], ids=["before", "after"])
def test_a_signal_at_any_moment_of_a_write_leaves_a_continuable_chain(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str, done: bool
) -> None:
    handed_on: list[bytes] = []
    journal = Journal(tmp_path, handed_on.append)
    journal.write(Entry.OPENED, 0.0)
    original = getattr(os, moment)

    def interrupted(*arguments: object) -> object:
        monkeypatch.setattr(os, moment, original)
        if done:
            original(*arguments)
        raise KeyboardInterrupt

    monkeypatch.setattr(os, moment, interrupted)
    with pytest.raises(KeyboardInterrupt):
        journal.write(Entry.INTENT, 1.0, step="ct_import")
    journal.write(Entry.INTERRUPTED, 1.0, step="ct_import")
    journal.write(Entry.CLOSED, 1.0)
    journal.close()
    in_file = moment != "write" or done
    assert [line["entry"] for line in read_journal(journal.path)] == [
        "opened",
        *(["intent"] if in_file else []),
        "interrupted",
        "closed",
    ]
    assert b"".join(handed_on) == journal.path.read_bytes()


def test_a_partially_written_line_is_removed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    journal = Journal(tmp_path)
    original = os.write
    monkeypatch.setattr(os, "write", lambda file, line: original(file, line[:9]))
    with pytest.raises(JournalNotWritable, match="cut"):
        journal.write(Entry.OPENED, 0.0)
    monkeypatch.undo()
    assert journal.path.read_bytes() == b""
    journal.write(Entry.FINDING, 0.0)
    assert [line["entry"] for line in read_journal(journal.path)] == ["finding"]


@pytest.mark.hazard(33)
@pytest.mark.parametrize("call", ["write", "fdatasync"])
def test_the_end_of_a_run_can_be_journalled_even_on_a_full_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str
) -> None:
    journal = Journal(tmp_path)
    journal.write(Entry.INTENT, 0.0, step="ct_import")
    original = getattr(os, call)

    def on_full_disk(*arguments: object) -> object:
        if (tmp_path / ROOM_FILE).exists():
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return original(*arguments)

    monkeypatch.setattr(os, call, on_full_disk)
    with pytest.raises(JournalNotWritable, match="No space left"):
        journal.write(Entry.MOTION, 1.0)
    journal.write(Entry.FAILED, 2.0, step="ct_import", what="No space left")
    journal.write(Entry.CLOSED, 2.0, outcome="failed")
    journal.close()
    assert [line["entry"] for line in read_journal(journal.path)] == ["intent", "failed", "closed"]
    assert os.listdir(tmp_path) == [JOURNAL_FILE]


def let_no_room_be_held(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)


@pytest.mark.hazard(33)
def test_an_intent_is_refused_without_disk_space_for_the_end_of_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    let_no_room_be_held(monkeypatch)
    with pytest.raises(JournalNotWritable, match="No space left"):
        Journal(tmp_path).write(Entry.INTENT, 0.0, step="ct_import")
    assert os.listdir(tmp_path) == [JOURNAL_FILE]


@pytest.mark.hazard(33)
def test_a_journal_is_not_taken_up_without_disk_space_for_the_end_of_the_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal(tmp_path)
    journal.write(Entry.CLOSED, 0.0, outcome="done")
    journal.close()

    let_no_room_be_held(monkeypatch)
    with pytest.raises(JournalNotWritable, match="No space left"):
        Journal.reopen_run(tmp_path, read_chain(journal.path))
    assert os.listdir(tmp_path) == [JOURNAL_FILE]


@pytest.mark.hazard(33)
def test_a_journal_whose_unflushed_line_cannot_be_removed_takes_no_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = Journal(tmp_path)
    journal.write(Entry.INTENT, 0.0, step="ct_import")  # holds room for the last line

    def broken(*_: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    for call in ("fdatasync", "ftruncate"):
        monkeypatch.setattr(os, call, broken)
    for _ in range(2):
        with pytest.raises(JournalNotWritable, match="a line was not flushed, and Input/output error"):
            journal.write(Entry.FAILED, 1.0)
        monkeypatch.undo()
    assert journal.path.read_bytes().count(b"\n") == 2  # the second is the line that stayed


@pytest.mark.hazard(33)
def test_a_closed_journal_accepts_no_further_entries(tmp_path: Path) -> None:
    journal = Journal(tmp_path)
    journal.close()
    with pytest.raises(JournalNotWritable, match="the journal is closed"):
        journal.write(Entry.INTENT, 0.0, step="ct_import")
