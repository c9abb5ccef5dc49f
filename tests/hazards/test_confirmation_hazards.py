"""Hazard 36: only a typed yes in time is a yes."""

from __future__ import annotations

import io
import os
import pty
from collections.abc import Iterator

import pytest

from procedures.cli.case.operators import TerminalOperator
from procedures.engine.operator import Question

VALUE = "predicted target error 0.21 mm rms"


@pytest.fixture
def keyboard(monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """A terminal as standard input; what is written to the descriptor is typed."""
    primary, secondary = pty.openpty()
    with os.fdopen(secondary, "r") as stream:
        monkeypatch.setattr("sys.stdin", stream)
        yield primary
    os.close(primary)


class Screen(io.StringIO):
    """Standard error that a person reads: what is to be typed is typed when the question stands there."""

    def __init__(self, keyboard: int, typed: bytes) -> None:
        super().__init__()
        self._keyboard, self._typed = keyboard, typed

    def flush(self) -> None:
        if "Type yes to confirm" in self.getvalue() and self._typed:
            os.write(self._keyboard, self._typed)
            self._typed = b""


def _ask(timeout_s: float = 5.0) -> bool:
    return TerminalOperator().confirm(Question("accept the registration", VALUE, timeout_s))


@pytest.mark.hazard(36)
def test_without_an_answer_in_time_the_answer_is_no(keyboard: int) -> None:
    assert not _ask(timeout_s=0.05)


@pytest.mark.hazard(36)
@pytest.mark.parametrize("typed", [b"\n", b"y\n", b"ok\n", b"no\n", b"yes please\n"])
def test_anything_but_a_typed_yes_is_no(keyboard: int, typed: bytes, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.stderr", Screen(keyboard, typed))
    assert not _ask()


@pytest.mark.hazard(36)
def test_a_typed_yes_is_a_yes_and_the_value_was_shown(keyboard: int, monkeypatch: pytest.MonkeyPatch) -> None:
    screen = Screen(keyboard, b"yes\n")
    monkeypatch.setattr("sys.stderr", screen)
    assert _ask()
    assert VALUE in screen.getvalue()


@pytest.mark.hazard(36)
def test_a_yes_that_was_typed_before_the_question_stood_there_answers_nothing(keyboard: int) -> None:
    os.write(keyboard, b"yes\n")
    assert not _ask(timeout_s=0.2)


@pytest.mark.hazard(36)
def test_without_a_terminal_nothing_is_confirmed(monkeypatch: pytest.MonkeyPatch) -> None:
    reader, writer = os.pipe()
    os.write(writer, b"yes\n")
    os.close(writer)
    with os.fdopen(reader, "r") as stream:
        monkeypatch.setattr("sys.stdin", stream)
        assert not _ask()
