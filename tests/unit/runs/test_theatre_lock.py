"""One program at a time has a theatre's devices, and says for which run."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path

import pytest

from procedures.engine.errors import TheatreInUse, TheatreNotNoted
from procedures.runs import arm_notes
from procedures.runs.arm_notes import TheatreNote, read_note
from procedures.runs.theatre_lock import (
    find_theatre_user,
    hold_theatre,
    read_last_notes,
    require_free_theatre,
)
from ronna_hw.roles import MASTER

NOBODY = 65534  # an account without rights


@pytest.fixture
def theatre(tmp_path: Path) -> Path:
    path = tmp_path / "theatre.toml"
    path.write_text("schema = 1")
    return path


@pytest.fixture
def arms_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where the notes of real arms are for this test, instead of the computer's own."""
    folder = tmp_path / "arms"
    monkeypatch.setattr(arm_notes, "ARMS_FOLDER", folder)
    return folder


def lock_file(theatre: Path) -> Path:
    return theatre.with_name(".theatre.toml.in-use")


def test_a_second_program_is_refused_with_the_run_and_the_process_of_the_first(theatre: Path) -> None:
    with hold_theatre(theatre, theatre.parent / "run-1"):
        named = rf"run-1 \(pid {os.getpid()}\) is using this theatre"
        with pytest.raises(TheatreInUse, match=named), hold_theatre(theatre, theatre.parent / "run-2"):
            pass
        with pytest.raises(TheatreInUse, match="run-1"):
            require_free_theatre(theatre)
    require_free_theatre(theatre)


def test_the_lock_survives_an_editor_that_replaces_the_theatre_file(theatre: Path) -> None:
    with hold_theatre(theatre, theatre.parent / "run-1"):
        other = theatre.with_name("other")
        other.write_text("schema = 1")
        other.rename(theatre)
        assert find_theatre_user(theatre) is not None


def test_one_file_under_two_names_is_one_theatre(theatre: Path) -> None:
    link = theatre.with_name("link.toml")
    link.symlink_to(theatre)
    with hold_theatre(link, theatre.parent / "run-1"):
        assert find_theatre_user(theatre) is not None


def test_a_user_without_a_run_is_named_as_a_program(theatre: Path) -> None:
    with hold_theatre(theatre, None):
        user = find_theatre_user(theatre)
        assert user is not None
        assert user.seen == f"another program (pid {os.getpid()}) is using this theatre"


def test_a_note_of_another_process_names_no_run(theatre: Path) -> None:
    with hold_theatre(theatre, theatre.parent / "run-1"):
        lock_file(theatre).write_text('{"run": "/runs/long-ended", "pid": 1, "moved_before": null}')
        user = find_theatre_user(theatre)
        assert user is not None
        assert user.run is None


@pytest.mark.hazard(5)
@pytest.mark.parametrize("content", [b"{", b"[1]", b'{"run": 5}', b"\xff"])
def test_from_a_damaged_note_nobody_knows_who_moved_the_arm_until_a_run_moves_it(
    theatre: Path, content: bytes
) -> None:
    lock_file(theatre).write_bytes(content)
    for _ in range(2):
        assert read_last_notes(theatre)[0].unreadable
        with hold_theatre(theatre, None) as (before,):
            assert before.unreadable
    assert read_note(theatre.with_name("none")) == TheatreNote()
    lock_file(theatre).write_bytes(b"")  # made, and its program killed
    assert not read_last_notes(theatre)[0].unreadable


def _of_nobody(path: Path) -> None:
    if os.geteuid() != 0:
        pytest.skip("only root can give a file to another account")
    os.chown(path, NOBODY, NOBODY)


@pytest.mark.hazard(5)
@pytest.mark.parametrize(
    "give", [_of_nobody, lambda path: path.chmod(0o666)], ids=["of another account", "writable by all"]
)
def test_a_note_that_another_account_can_have_written_is_not_believed(
    tmp_path: Path, arms_folder: Path, give: Callable[[Path], None]
) -> None:
    theatre = with_arm(tmp_path / "a.toml", "tcp://192.168.10.2:54602")
    with hold_theatre(theatre, None):
        pass
    (note,) = arms_folder.iterdir()
    give(note)
    for _ in range(2):
        assert read_last_notes(theatre)[0].unreadable
    with hold_theatre(theatre, None) as (before,):
        assert before.unreadable
    assert not note.stat().st_mode & 0o002


@pytest.mark.hazard(5)
def test_a_note_that_another_account_can_have_removed_is_not_known(tmp_path: Path, arms_folder: Path) -> None:
    theatre = with_arm(tmp_path / "a.toml", "tcp://192.168.10.2:54602")
    with hold_theatre(theatre, None):
        pass
    _of_nobody(arms_folder)
    assert not read_last_notes(theatre)[0].unreadable  # it is there, and ours
    (note,) = arms_folder.iterdir()
    note.unlink()
    assert read_last_notes(theatre)[0].unreadable


@pytest.mark.hazard(5)
def test_a_note_is_believed_by_every_user_of_the_group_that_may_write_it(
    tmp_path: Path, arms_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    theatre = with_arm(tmp_path / "a.toml", "tcp://192.168.10.2:54602")
    with hold_theatre(theatre, None):
        pass
    for path in (arms_folder, *arms_folder.iterdir()):
        path.chmod(path.stat().st_mode | 0o020)
        if os.geteuid() == 0:  # who owns everything that root made
            os.chown(path, NOBODY, -1)
    monkeypatch.setattr(arm_notes.os, "geteuid", lambda: NOBODY - 1)
    assert not read_last_notes(theatre)[0].unreadable
    monkeypatch.setattr(arm_notes.os, "getegid", lambda: NOBODY)
    monkeypatch.setattr(arm_notes.os, "getgroups", list)
    assert read_last_notes(theatre)[0].unreadable


def test_a_killed_run_with_a_name_that_no_folder_has_may_have_moved_the_arm(theatre: Path) -> None:
    lock_file(theatre).write_bytes(b'{"run": "a\\u0000b", "pid": 1}')
    assert read_last_notes(theatre)[0].moved_before == Path("a\0b")


@pytest.mark.hazard(5)
@pytest.mark.parametrize("endpoint", ["tcp://192.168.10.2:54602", "serial:///dev/ttyUSB3"])
def test_a_copy_of_a_theatre_file_is_the_same_arm(tmp_path: Path, arms_folder: Path, endpoint: str) -> None:
    one, other = with_arm(tmp_path / "a.toml", endpoint), with_arm(tmp_path / "b" / "a.toml", endpoint, 2)
    with hold_theatre(one, None):
        with pytest.raises(TheatreInUse):
            hold_theatre(other, None).__enter__()
        assert find_theatre_user(other) is not None
    (made,) = arms_folder.iterdir()
    assert made.name in ("192.168.10.2.in-use", "_dev_ttyUSB3.in-use")
    assert arms_folder.stat().st_mode & 0o1777 == 0o1777
    with hold_theatre(with_arm(tmp_path / "c.toml", "tcp://192.168.10.3:54602"), None):
        require_free_theatre(one)


@pytest.mark.hazard(5)
def test_a_controller_is_the_same_under_every_name_that_leads_to_it(
    tmp_path: Path, arms_folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def found(name: str, *_: object, **__: object) -> list[tuple[object, ...]]:
        return [(0, 0, 0, "", ("192.168.10.2" if name == "kuka.lab" else name, 0))]

    monkeypatch.setattr(socket, "getaddrinfo", found)
    endpoints = ("tcp://kuka.lab:54602", "tcp://KUKA.lab.:54602", "tcp://192.168.10.2:54602")
    named, spelt, numbered = (
        with_arm(tmp_path / f"{number}.toml", endpoint) for number, endpoint in enumerate(endpoints)
    )
    with hold_theatre(named, None):
        assert find_theatre_user(spelt) is not None
        assert find_theatre_user(numbered) is not None


@pytest.mark.hazard(5)
def test_an_arm_that_assists_in_one_theatre_is_in_use_for_another_in_which_it_is_the_master(
    tmp_path: Path, arms_folder: Path
) -> None:
    alone = with_arm(tmp_path / "alone.toml", "tcp://192.168.10.3:54602")
    pair = with_arm(tmp_path / "pair.toml", "tcp://192.168.10.2:54602")
    pair.write_text(
        f"{pair.read_text()}[robot.assistant]\n"
        'driver = "kuka_rsi"\n'
        'endpoints = { rsi = "udp://0.0.0.0:59153", eki = "tcp://192.168.10.3:54602" }\n'
    )
    run = tmp_path / "run-1"
    with hold_theatre(pair, run):
        assert sorted(note.name for note in arms_folder.iterdir()) == [
            "192.168.10.2.in-use",
            "192.168.10.3.in-use",
        ]
        with pytest.raises(TheatreInUse, match="run-1"):
            hold_theatre(alone, None).__enter__()
    require_free_theatre(alone)
    with hold_theatre(alone, None), pytest.raises(TheatreInUse):
        require_free_theatre(pair)
    with hold_theatre(alone, None), hold_theatre(pair, run, (MASTER,)):
        pass  # a case with one arm does not need the other
    assert {read_note(note).run for note in arms_folder.iterdir()} == {run, None}


def test_a_note_that_is_a_link_is_refused_and_what_it_leads_to_stays(
    tmp_path: Path, arms_folder: Path
) -> None:
    secret = tmp_path / "secret"
    secret.write_text("precious")
    secret.chmod(0o600)
    arms_folder.mkdir()
    (arms_folder / "192.168.10.2.in-use").symlink_to(secret)
    with pytest.raises(TheatreNotNoted):
        hold_theatre(with_arm(tmp_path / "a.toml", "tcp://192.168.10.2:54602"), None).__enter__()
    assert (secret.read_text(), secret.stat().st_mode & 0o777) == ("precious", 0o600)


def test_simulated_arms_at_the_same_address_are_used_side_by_side(tmp_path: Path, arms_folder: Path) -> None:
    one, other = (
        with_arm(tmp_path / name, "tcp://127.0.0.1:54602", local="127.0.0.1") for name in ("a.toml", "b.toml")
    )
    with hold_theatre(one, None), hold_theatre(other, None):
        assert find_theatre_user(one) is not None
    assert not arms_folder.exists()


@pytest.mark.hazard(5)
def test_a_copy_of_a_simulated_theatre_s_file_is_the_same_arm_and_another_theatre_at_its_address_is_not(
    tmp_path: Path, arms_folder: Path
) -> None:
    address = "tcp://127.0.0.1:54602"
    one, copy, another = (
        with_arm(tmp_path / name, address, local="127.0.0.1", identity=identity * 32)
        for name, identity in (("a.toml", "a"), ("copy.toml", "a"), ("b.toml", "b"))
    )
    with hold_theatre(one, None):
        with pytest.raises(TheatreInUse):
            hold_theatre(copy, None).__enter__()
        require_free_theatre(another)


def with_arm(
    path: Path, endpoint: str, cycle_ms: int = 4, local: str = "0.0.0.0", identity: str = ""
) -> Path:
    """A theatre file with an arm whose controller is there."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(
        f'schema = 1\ntheatre = "lab"\nidentity = "{identity}"\n'
        '[robot.master]\ndriver = "kuka_rsi"\n'
        f'endpoints = {{ rsi = "udp://{local}:59152", eki = "{endpoint}" }}\n'
        f"options = {{ cycle_ms = {cycle_ms} }}\n"
    )
    return path


@pytest.fixture
def read_only(monkeypatch: pytest.MonkeyPatch) -> Callable[[], AbstractContextManager[None]]:
    """Opens nothing for writing while it is entered, as for a user who may not write there."""
    opened = os.open

    def for_reading(path: Path, flags: int, *mode: int) -> int:
        if flags & os.O_RDWR:
            raise PermissionError
        return opened(path, flags, *mode)

    @contextmanager
    def entered() -> Iterator[None]:
        with monkeypatch.context() as patch:
            patch.setattr("procedures.runs.theatre_lock.os.open", for_reading)
            yield

    return entered


ReadOnly = Callable[[], AbstractContextManager[None]]


@pytest.mark.hazard(5)
@pytest.mark.parametrize("other_users_note", [True, False])
def test_a_run_that_cannot_be_noted_for_the_next_one_is_refused(
    theatre: Path, read_only: ReadOnly, other_users_note: bool
) -> None:
    if other_users_note:
        with hold_theatre(theatre, theatre.parent / "run-1"):
            pass
    with read_only(), pytest.raises(TheatreNotNoted, match="PRO-045"):
        hold_theatre(theatre, theatre.parent / "run-2").__enter__()
    assert find_theatre_user(theatre) is None


@pytest.mark.hazard(5)
def test_a_user_who_can_write_next_to_the_theatre_is_kept_out_by_one_who_cannot(
    theatre: Path, read_only: ReadOnly
) -> None:
    with ExitStack() as first:
        with read_only():
            first.enter_context(hold_theatre(theatre, theatre.parent / "run-1", only_leaving=True))
        with pytest.raises(TheatreInUse):
            hold_theatre(theatre, theatre.parent / "run-2").__enter__()
        assert find_theatre_user(theatre) is not None
    assert find_theatre_user(theatre) is None


def test_a_note_that_a_group_may_write_stays_so(theatre: Path) -> None:
    lock_file(theatre).touch()
    lock_file(theatre).chmod(0o660)
    with hold_theatre(theatre, None):
        assert lock_file(theatre).stat().st_mode & 0o777 == 0o664
