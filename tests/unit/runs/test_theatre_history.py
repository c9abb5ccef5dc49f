"""One theatre file, updated in place: nothing is lost, and every earlier state can be restored."""

from __future__ import annotations

import json
import os
import resource
from pathlib import Path
from threading import Thread

import pytest
from coded_errors import raises
from user_commands import in_this_process

from procedures.cli.doctor.calibrations import history_diagnostics
from procedures.cli.procedure import app
from procedures.engine.errors import HISTORY_CHANGED
from procedures.runs import theatre_history
from procedures.runs.theatre_history import (
    UpdateAuthor,
    describe_state,
    describe_updates_since,
    find_state,
    history_path,
    read_states,
    restore,
    update_tables,
)
from ronna_hw.command_line.errors import as_ronna_error
from ronna_hw.config import BadTheatreFile, read_theatre_file
from ronna_hw.evidence.manifest import sha256_of

FORMER = """\ufeff# Our cell.\r
theatre = "lab"  # on the third floor\r
flange = "changer"\r
\r
[procedure]\r
approach_mm = 50.0  # as in the protocol\r
"""
SIGNED = UpdateAuthor("ronna-tool define", by="Ana Novak")


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
    assert not history_path(lab).read_bytes()
    monkeypatch.undo()
    define(lab, 3)
    lab.write_bytes(FORMER.encode())  # as killed before it was replaced
    history_path(lab).write_bytes(history_path(lab).read_bytes().splitlines(keepends=True)[0])
    assert len(read_states(lab)) == 1
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
        (("--restore", 7, "--by", "A. N."), "has no state 7; expected 0"),
        (("--run", tmp_path), "is not the folder of a run"),
    ):
        refused = in_this_process(app, "theatre-history", lab, *words)
        assert refused.returncode == 2
        assert said in refused.stderr
    assert "was updated since" not in str(describe_updates_since(lab, "0" * 64))


@pytest.mark.parametrize("field", ["text", "former", "by"])
def test_an_edited_line_of_the_history_is_refused_and_nothing_is_restored(lab: Path, field: str) -> None:
    define(lab, 3)
    define(lab, 4)
    history, present = history_path(lab), lab.read_bytes()
    first, *others = history.read_text().splitlines()
    edited = {**json.loads(first), field: json.loads(first)[field].replace("a", "b")}
    history.write_text("\n".join([json.dumps(edited), *others, ""]))
    refused = in_this_process(app, "theatre-history", lab, "--restore", 1, "--by", "A. N.")
    assert (refused.returncode, "PRO-046" in refused.stderr) == (3, True), refused.stderr
    assert "line 1 of lab.toml.history" in " ".join(refused.stderr.split())
    with raises(HISTORY_CHANGED, match=r"SHA-256 [0-9a-f]{64}, got [0-9a-f]{64}"):
        define(lab, 5)
    assert lab.read_bytes() == present


def test_removed_lines_of_the_history_are_noticed(lab: Path) -> None:
    for number in (3, 4, 5):
        define(lab, number)
    history = history_path(lab)
    lines = history.read_bytes().splitlines(keepends=True)
    for kept in (lines[:2] + lines[4:], lines[2:]):
        history.write_bytes(b"".join(kept))
        with raises(HISTORY_CHANGED, match="PRO-046"):
            read_states(lab)


def test_a_history_of_unchained_lines_is_continued_and_its_texts_are_checked(lab: Path) -> None:
    define(lab, 3)
    history = history_path(lab)
    older = json.loads(history.read_text().splitlines()[0])
    del older["previous"]
    history.write_text(json.dumps(older) + "\n")
    define(lab, 4)
    assert [one.number for one in read_states(lab) if one.update is not None] == [1, 2]
    for field in ("text", "former"):
        history.write_text(json.dumps({**older, field: older[field] + "# more\n"}) + "\n")
        with raises(HISTORY_CHANGED, match=f"line 1 .* its {field} is not the recorded one"):
            read_states(lab)


def test_an_update_that_was_in_force_stays_listed_when_the_file_is_edited_back(lab: Path) -> None:
    define(lab, 3)
    before = lab.read_bytes()
    restore(lab, read_states(lab)[0], UpdateAuthor("restored state 0", by="Rest O"))
    lab.write_bytes(before)
    assert [describe_state(one).rpartition(", ")[2].partition(":")[0] for one in read_states(lab)] == [
        "as first known", "ronna-tool define", "restored state 0", "edited by hand"
    ]  # fmt: skip


def test_a_line_that_the_disk_takes_only_a_part_of_is_withdrawn_and_the_file_stays(lab: Path) -> None:
    define(lab, 3)
    history, file = history_path(lab).read_bytes(), lab.read_bytes()
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (len(history) + 100, limits[1]))
    try:
        with pytest.raises(OSError, match=r"lab\.toml\.history") as problem:
            define(lab, 4)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert as_ronna_error(problem.value).code == "CLI-003"
    assert (history_path(lab).read_bytes(), lab.read_bytes()) == (history, file)


def test_a_line_cut_off_by_a_crash_is_named_and_hides_no_other(lab: Path) -> None:
    define(lab, 3)
    with history_path(lab).open("ab") as file:
        file.write(b'{"time": "2026-')
    for updates, number in ((1, 4), (2, 5)):
        listed = in_this_process(app, "theatre-history", lab)
        assert (listed.returncode, "line 3 of lab.toml.history was cut off" in listed.stderr) == (0, True)
        assert len(read_states(lab)) == 1 + updates
        define(lab, number)


def test_a_record_edited_by_hand_under_its_identifier_is_told_by_the_doctor(lab: Path) -> None:
    define(lab, 3)
    lab.write_text(lab.read_text() + "frame = { port = 1 }\n")  # which no command writes
    assert not list(history_diagnostics(lab))
    lab.write_text(lab.read_text().replace("frame = { port = 1 }\n", "").replace("90.0", "97.0"))
    define(lab, 4)  # takes the edited record over, and does not sign it
    (told,) = history_diagnostics(lab)
    assert (told.subject, told.well) == ("record tools.drill3", True)
    assert "drill-3 is not as it was put in" in told.seen
    assert told.seen.endswith("tools.drill3: none -> drill-3): centre_of_gravity_mm edited by hand")


def test_the_doctor_tells_of_a_changed_history(lab: Path) -> None:
    define(lab, 3)
    history_path(lab).write_text(history_path(lab).read_text().replace("Ana", "Eva"))
    (told,) = history_diagnostics(lab)
    assert told.seen.startswith("PRO-046 line 1 of lab.toml.history was changed")
