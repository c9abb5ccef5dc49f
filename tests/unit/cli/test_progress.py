"""The progress bar of a long-running command."""

from __future__ import annotations

from io import StringIO
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from procedures.cli.calibrating import calibration
from ronna_hw.command_line import messages


@pytest.fixture
def now() -> SimpleNamespace:
    return SimpleNamespace(s=100.0)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch, now: SimpleNamespace) -> StringIO:
    """What a terminal was sent."""
    sent = StringIO()
    console = Console(file=sent, force_terminal=True, width=100)
    monkeypatch.setattr(messages, "message_console", lambda: console)
    monkeypatch.setattr(messages, "on_terminal", lambda _stream: True)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setattr(messages, "time", SimpleNamespace(monotonic=lambda: now.s))
    return sent


def test_the_bar_and_clock_of_a_calibration_pause_while_a_question_is_open(
    monkeypatch: pytest.MonkeyPatch, terminal: StringIO, now: SimpleNamespace
) -> None:
    monkeypatch.setattr(calibration, "terminal_observers", lambda asking, _opened: asking)
    with messages.progress_bar("looking") as bar:
        asking: Any = calibration.bar_observers(bar)
        now.s += 3.0
        bar(0.1)
        with asking():
            before = terminal.getvalue()
            bar(0.2)
            now.s += 60.0
            after = terminal.getvalue()
        now.s += 1.0
        bar(0.3)
    assert "0:00:03" in before
    assert after == before
    assert "0:00:04" in terminal.getvalue()
    assert "0:01:" not in terminal.getvalue()


def test_without_a_terminal_a_line_a_minute_tells_how_far_it_is(
    monkeypatch: pytest.MonkeyPatch,
    terminal: StringIO,
    now: SimpleNamespace,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(messages, "on_terminal", lambda _stream: False)
    with messages.progress_bar("strategies") as bar:
        for share in range(10):
            bar(share / 10.0)
            now.s += 20.0
    assert capsys.readouterr().err.splitlines() == [
        "strategies: 30% after 1 min",
        "strategies: 60% after 2 min",
        "strategies: 90% after 3 min",
    ]
    assert terminal.getvalue() == ""


@pytest.mark.parametrize(("name", "value"), [("TERM", "dumb"), ("NO_COLOR", "1")])
def test_a_terminal_without_escape_codes_gets_lines_in_place_of_a_bar(
    monkeypatch: pytest.MonkeyPatch,
    terminal: StringIO,
    now: SimpleNamespace,
    capsys: pytest.CaptureFixture[str],
    name: str,
    value: str,
) -> None:
    monkeypatch.setenv(name, value)
    with messages.progress_bar("strategies") as bar:
        now.s += 61.0
        bar(0.5)
    assert (terminal.getvalue(), capsys.readouterr().err) == ("", "strategies: 50% after 1 min\n")


def test_a_bar_not_yet_shown_stays_hidden_during_a_question(terminal: StringIO, now: SimpleNamespace) -> None:
    with messages.progress_bar("looking") as bar:
        with bar.hidden():
            now.s += 60.0
            bar(0.5)
        bar(0.6)
    assert terminal.getvalue() == ""
