"""Commands run as a user runs them, and what they must not leave behind."""

from __future__ import annotations

import contextlib
import io
import os
import signal
import subprocess
import sys
import time
import uuid
from collections.abc import Sequence
from pathlib import Path

import typer

from ronna_hw.command_line.terminal import exit_code_of

TOKEN = "RONNA_TEST_TOKEN"
ENDED_S = 30.0  # on a busy computer; children end within 2 s of their parent where there is none


class Commands:
    """Runs our commands with a token in their environment, by which every descendant is found again."""

    def __init__(self) -> None:
        self.token = uuid.uuid4().hex
        self.environment = {**os.environ, TOKEN: self.token}
        self._started: list[subprocess.Popen[str]] = []

    def line(self, name: str, *arguments: str) -> list[str]:
        return [str(Path(sys.executable).parent / name), *arguments]

    def run(self, name: str, *arguments: str, timeout_s: float = 150.0) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            self.line(name, *arguments),
            env=self.environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )

    def start(self, name: str, *arguments: str, stdin: int = subprocess.DEVNULL) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            self.line(name, *arguments),
            env=self.environment,
            stdin=stdin,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        self._started.append(process)
        return process

    def survivors(self) -> list[int]:
        """Process numbers of everything that was started with the token and still lives."""
        mark = f"{TOKEN}={self.token}".encode()
        found = []
        for entry in Path("/proc").iterdir():
            if not entry.name.isdigit():
                continue
            try:
                if mark in (entry / "environ").read_bytes():
                    found.append(int(entry.name))
            except OSError:
                continue
        return found

    def await_no_survivors(self) -> list[int]:
        """Wait until nothing lives any more; returns what still does after the limit."""
        deadline = time.monotonic() + ENDED_S
        while (alive := self.survivors()) and time.monotonic() < deadline:
            time.sleep(0.05)
        return alive

    def end_all(self) -> None:
        """End what a failed test left behind, so that only this one fails."""
        for number in self.survivors():
            with contextlib.suppress(ProcessLookupError):
                os.kill(number, signal.SIGKILL)
        for process in self._started:
            process.wait()
            for pipe in (process.stdout, process.stderr):
                if pipe is not None:
                    pipe.close()


def one_error(stderr: str) -> Sequence[str]:
    """The lines of an error message off a terminal: one or two, no box, no trace. A simulated theatre tells
    its control port before, a case what it did.
    """
    before = (
        "a script answers",
        "control port tcp://",
        "pendant at ",
        "done ",
        "note: ",
    )
    lines = [line for line in stderr.strip().splitlines() if not line.startswith(before)]
    assert 1 <= len(lines) <= 2, stderr
    assert "Traceback" not in stderr
    assert not any(character in stderr for character in "╭╰│")
    return lines


def in_this_process(app: typer.Typer, *arguments: object) -> subprocess.CompletedProcess[str]:
    """Run a command as its console script does, without the second that a new process costs."""
    out, errors, words = io.StringIO(), io.StringIO(), [str(argument) for argument in arguments]
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        code = exit_code_of(app, words)
    return subprocess.CompletedProcess(words, code, out.getvalue(), errors.getvalue())
