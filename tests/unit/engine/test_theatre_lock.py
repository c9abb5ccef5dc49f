"""One program at a time has a theatre's devices, and says for which run."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from pathlib import Path

import pytest

from procedures.engine.errors import TheatreInUse, TheatreNotNoted
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


@pytest.fixture
def read_only(monkeypatch: pytest.MonkeyPatch) -> Callable[[], AbstractContextManager[None]]:
    """Opens nothing for writing while it is entered, as for a user who may not write there."""
    opened = os.open

    def for_reading(path: Path, flags: int, *mode: int) -> int:
        if flags & os.O_CREAT:
            raise PermissionError
        return opened(path, flags, *mode)

    @contextmanager
    def entered() -> Iterator[None]:
        with monkeypatch.context() as patch:
            patch.setattr("procedures.engine.theatre_lock.os.open", for_reading)
            yield

    return entered


ReadOnly = Callable[[], AbstractContextManager[None]]


@pytest.mark.hazard(5)
@pytest.mark.parametrize("other_users_note", [True, False])
def test_a_run_that_cannot_be_noted_for_the_next_one_is_refused(
    theatre: Path, read_only: ReadOnly, other_users_note: bool
) -> None:
    if other_users_note:
        with held_theatre(theatre, theatre.parent / "run-1"):
            pass
    with read_only(), pytest.raises(TheatreNotNoted, match="PRO-045"):
        held_theatre(theatre, theatre.parent / "run-2").__enter__()
    assert theatre_user(theatre) is None


@pytest.mark.hazard(5)
def test_a_user_who_can_write_next_to_the_theatre_is_kept_out_by_one_who_cannot(
    theatre: Path, read_only: ReadOnly
) -> None:
    with ExitStack() as first:
        with read_only():
            first.enter_context(held_theatre(theatre, theatre.parent / "run-1", only_leaving=True))
        with pytest.raises(TheatreInUse):
            held_theatre(theatre, theatre.parent / "run-2").__enter__()
        assert theatre_user(theatre) is not None
    assert theatre_user(theatre) is None


def test_a_note_that_a_group_may_write_stays_so(theatre: Path) -> None:
    lock_file(theatre).touch()
    lock_file(theatre).chmod(0o660)
    with held_theatre(theatre, None):
        assert lock_file(theatre).stat().st_mode & 0o777 == 0o664
