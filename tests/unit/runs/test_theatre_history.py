"""One theatre file, updated in place: nothing is lost, and every earlier state can be restored."""

from __future__ import annotations

import os
from pathlib import Path
from threading import Thread

import pytest
from user_commands import in_this_process

from procedures.cli.procedure import app
from procedures.runs import theatre_history
from procedures.runs.theatre_history import (
    Signature,
    describe_updates_since,
    find_state,
    history_path,
    read_states,
    update_tables,
)
from ronna_hw.config import BadTheatreFile, read_theatre_file
from ronna_hw.evidence.manifest import sha256_of
from ronna_hw.records import write_atomically

FORMER = """\ufeff# Our cell.\r
theatre = "lab"  # on the third floor\r
flange = "changer"\r
\r
[procedure]\r
approach_mm = 50.0  # as in the protocol\r
"""
SIGNED = Signature("ronna-tool define", by="Ana Novak")


def tool(number: int) -> dict[str, object]:
    return {
        "identifier": f"drill-{number}",
        "created": theatre_history.datetime(2026, 1, 1, tzinfo=theatre_history.UTC),
        "expires": theatre_history.datetime(2026, 6, 1, tzinfo=theatre_history.UTC),
        "made_by": "Ana Novak",
        "purpose": "gripper",
        "number": number,
        "flange": "changer",
        "mass_kg": 1.0,
        "centre_of_gravity_mm": [0.0, 0.0, 90.0],
    }


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    path = tmp_path / "lab.toml"
    path.write_bytes(FORMER.encode())
    return path


def define(lab: Path, number: int) -> None:
    update_tables(lab, {"tools": {f"drill{number}": tool(number)}}, SIGNED)


def test_an_update_keeps_comments_and_rights_and_says_who_changed_what(lab: Path) -> None:
    lab.chmod(0o640)
    former = sha256_of(lab)
    define(lab, 3)
    assert read_theatre_file(lab).tools["drill3"].identifier == "drill-3"
    for comment in ("# Our cell.", "# on the third floor", "# as in the protocol"):
        assert comment in lab.read_text()
    assert lab.stat().st_mode & 0o777 == 0o640
    first, last = read_states(lab)
    assert (first.sha256, first.update, last.sha256) == (former, None, sha256_of(lab))
    assert last.update is not None
    assert (last.update.by, last.update.command) == ("Ana Novak", "ronna-tool define")
    assert last.update.changes == ("tools.drill3: none -> drill-3",)


def test_a_link_to_a_theatre_file_stays_a_link(lab: Path) -> None:
    (link := lab.with_name("today.toml")).symlink_to(lab)
    define(link, 3)
    assert link.is_symlink()
    assert "drill3" in read_theatre_file(lab).tools
    assert len(read_states(lab)) == 2


def test_an_update_that_would_spoil_the_file_writes_nothing(lab: Path) -> None:
    with pytest.raises(BadTheatreFile, match="CFG-001"):
        update_tables(lab, {"tools": {"drill": {**tool(3), "number": "three"}}}, SIGNED)
    assert lab.read_bytes() == FORMER.encode()
    assert len(read_states(lab)) == 1


def test_of_updates_at_the_same_time_none_is_lost(lab: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    passing = theatre_history.read_bounded

    def read_slowly(path: Path, limit: int) -> bytes:
        content = passing(path, limit)
        os.sched_yield()
        return content

    monkeypatch.setattr(theatre_history, "read_bounded", read_slowly)
    numbers = range(3, 11)
    updates = [Thread(target=define, args=(lab, number)) for number in numbers]
    for update in updates:
        update.start()
    for update in updates:
        update.join()
    assert set(read_theatre_file(lab).tools) == {f"drill{number}" for number in numbers}
    assert len(read_states(lab)) == 1 + len(numbers)


def test_an_update_cut_off_before_the_file_was_written_is_no_state(
    lab: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def crash(path: Path, content: bytes) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(theatre_history, "write_atomically", crash)
    with pytest.raises(KeyboardInterrupt):
        define(lab, 3)
    monkeypatch.setattr(theatre_history, "write_atomically", write_atomically)
    assert len(read_states(lab)) == 1
    history_path(lab).write_bytes(history_path(lab).read_bytes()[:-9])
    define(lab, 4)
    assert [one.update and one.update.changes for one in read_states(lab)] == [
        None, ("tools.drill4: none -> drill-4",)
    ]  # fmt: skip


def test_the_state_of_a_run_is_found_and_restored_byte_for_byte(lab: Path) -> None:
    of_run = sha256_of(lab)
    assert describe_updates_since(lab, of_run) is None
    define(lab, 3)
    with lab.open("a") as file:
        file.write("# by hand\n")
    define(lab, 4)
    said = describe_updates_since(lab, of_run)
    assert said is not None
    assert said.startswith("lab.toml was updated since its state 0: ")
    first, by_hand, second = said.partition(" 0: ")[2].split("; ")
    assert first.endswith("Ana Novak, ronna-tool define: tools.drill3: none -> drill-3")
    assert by_hand == "edited by hand"
    assert second.endswith("Ana Novak, ronna-tool define: tools.drill4: none -> drill-4")
    refused = in_this_process(app, "theatre-history", lab, "--restore", 0)
    assert (refused.returncode, "--by" in refused.stderr) == (2, True)
    done = in_this_process(
        app, "theatre-history", lab, "--restore", find_state(read_states(lab), of_run), "--by", "A. N."
    )
    assert done.returncode == 0, done.stderr
    assert sha256_of(lab) == of_run
    listed = in_this_process(app, "theatre-history", lab).stdout
    assert "A. N., restored state 0: tools.drill3: drill-3 -> none" in listed


def test_a_state_that_does_not_exist_and_a_folder_that_is_no_run_are_refused(
    lab: Path, tmp_path: Path
) -> None:
    for words, said in (
        (("--restore", 7, "--by", "A. N."), "expected 0 to 0"),
        (("--run", tmp_path), "is not the folder of a run"),
    ):
        refused = in_this_process(app, "theatre-history", lab, *words)
        assert refused.returncode == 2
        assert said in refused.stderr
    assert "was updated since" not in str(describe_updates_since(lab, "0" * 64))
