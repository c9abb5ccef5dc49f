"""One program at a time has a theatre's devices, and says for which run."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from procedures.engine.errors import TheatreInUse
from procedures.engine.theatre_lock import held_theatre, require_free_theatre, theatre_user


@pytest.fixture
def theatre(tmp_path: Path) -> Path:
    path = tmp_path / "theatre.toml"
    path.write_text("schema = 1")
    return path


def lock_file(theatre: Path) -> Path:
    return theatre.with_name(".theatre.toml.in-use")


def test_a_second_program_is_refused_with_the_run_and_the_process_of_the_first(theatre: Path) -> None:
    with held_theatre(theatre, theatre.parent / "run-1"):
        named = rf"run-1 \(pid {os.getpid()}\) is using this theatre"
        with pytest.raises(TheatreInUse, match=named), held_theatre(theatre, theatre.parent / "run-2"):
            pass
        with pytest.raises(TheatreInUse, match="run-1"):
            require_free_theatre(theatre)
    require_free_theatre(theatre)


def test_the_lock_survives_an_editor_that_replaces_the_theatre_file(theatre: Path) -> None:
    with held_theatre(theatre, theatre.parent / "run-1"):
        other = theatre.with_name("other")
        other.write_text("schema = 1")
        other.rename(theatre)
        assert theatre_user(theatre) is not None


def test_one_file_under_two_names_is_one_theatre(theatre: Path) -> None:
    link = theatre.with_name("link.toml")
    link.symlink_to(theatre)
    with held_theatre(link, theatre.parent / "run-1"):
        assert theatre_user(theatre) is not None


def test_a_user_without_a_run_is_named_as_a_program(theatre: Path) -> None:
    with held_theatre(theatre, None):
        user = theatre_user(theatre)
        assert user is not None
        assert user.seen == f"another program (pid {os.getpid()}) is using this theatre"


def test_a_note_of_another_process_names_no_run(theatre: Path) -> None:
    with held_theatre(theatre, theatre.parent / "run-1"):
        lock_file(theatre).write_text('{"run": "/runs/long-ended", "pid": 1, "moved_before": null}')
        user = theatre_user(theatre)
        assert user is not None
        assert user.run is None


@pytest.mark.parametrize("content", [b"", b"{", b"[1]", b'{"run": 5}', b'{"run": "a\\u0000b"}', b"\xff"])
def test_a_damaged_note_is_as_good_as_none(theatre: Path, content: bytes) -> None:
    lock_file(theatre).write_bytes(content)
    with held_theatre(theatre, theatre.parent / "run-1") as last:
        assert last is None


def test_a_theatre_in_a_folder_that_cannot_be_written_is_held_too(
    theatre: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened = os.open

    def read_only(path: Path, flags: int, *mode: int) -> int:
        if flags & os.O_CREAT:
            raise PermissionError
        return opened(path, flags, *mode)

    monkeypatch.setattr("procedures.engine.theatre_lock.os.open", read_only)
    with held_theatre(theatre, theatre.parent / "run-1"):
        assert not lock_file(theatre).exists()
        assert theatre_user(theatre) is not None
    assert theatre_user(theatre) is None
