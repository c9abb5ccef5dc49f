"""The progress bar of a long-running command."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from io import StringIO
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console

from procedures.cli.calibrating import running
from procedures.cli.case.opening import Watcher
from procedures.cli.case.request import TheatreRequest
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
    monkeypatch.setattr(messages, "time", SimpleNamespace(monotonic=lambda: now.s))
    return sent


def test_the_bar_and_clock_of_a_calibration_pause_while_a_question_is_open(
    monkeypatch: pytest.MonkeyPatch, terminal: StringIO, now: SimpleNamespace, tmp_path: Path
) -> None:
    at_question: list[str] = []

    @contextmanager
    def with_a_question(
        _request: object, _folder: object, _steps: object, watcher: Watcher, **_: object
    ) -> Iterator[SimpleNamespace]:
        with watcher.asking():
            at_question.append(terminal.getvalue())
            bar(0.2)
            now.s += 60.0
            at_question.append(terminal.getvalue())
        yield SimpleNamespace(run_to=lambda: None)

    monkeypatch.setattr(running, "opened_steps", with_a_question)
    with messages.progress_bar("looking") as bar:
        now.s += 3.0
        bar(0.1)
        running.run_steps(TheatreRequest(), tmp_path, (), bar, title="looks")
        now.s += 1.0
        bar(0.3)
    before, after = at_question
    assert "0:00:03" in before
    assert after == before
    assert "0:00:04" in terminal.getvalue()
    assert "0:01:" not in terminal.getvalue()


def test_a_bar_not_yet_shown_stays_hidden_during_a_question(terminal: StringIO, now: SimpleNamespace) -> None:
    with messages.progress_bar("looking") as bar:
        with bar.hidden():
            now.s += 60.0
            bar(0.5)
        bar(0.6)
    assert terminal.getvalue() == ""
