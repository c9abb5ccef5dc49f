"""What a console hears of the program that started it."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from typing import Any

import pytest

from procedures.cli.console import link
from procedures.cli.console.desk import Desk


class Listening:
    """A console's process that only keeps its end of the socket."""

    def __init__(self, *_command: Any, inherited: tuple[int, ...], **_more: Any) -> None:
        self.socket = socket.socket(fileno=os.dup(inherited[0]))
        self.socket.settimeout(5.0)
        self.process = self

    def await_ready(self, _limit_s: float) -> dict[str, str]:
        return {}

    def wait(self, timeout: float) -> None:
        pass

    def stop(self) -> None:
        self.socket.close()


def test_a_console_hears_that_the_program_lives_before_the_theatre_is_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(link, "ChildProcess", Listening)
    console: Any = link.ConsoleLink(tmp_path, Desk(waits=True), 0, lambda _words: None)
    try:
        heard = console._child.socket.recv(100)
    finally:
        console.close()
    assert heard.startswith(b'{"beat":1}\n')
