"""A terminal with a command on it, as a person has it."""

from __future__ import annotations

import fcntl
import os
import pty
import re
import select
import signal
import subprocess
import termios
import time
from collections.abc import Callable, Mapping

from user_commands import Commands

AWAITED_S = 100.0
AT_QUESTION = "the arm rests; Ctrl-C again ends the command"
XTERM = {"TERM": "xterm"}
CTRL_C = "\x03"  # typed: the terminal signals every process of its foreground group
STYLE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")  # colours and cursor moves


def heed_ctrl_c() -> None:
    """Let SIGINT end a new process, although a shell ignores it in what it starts in the background."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def _lead_the_terminal() -> None:
    """Make the new process the leader of a session whose terminal is its standard input."""
    os.setsid()
    heed_ctrl_c()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


class Terminal:
    """A pseudo-terminal with `ronna-procedure`, or another `command`, on it.

    `raw` is what it was sent, `text` the same without styles.
    """

    def __init__(
        self,
        commands: Commands,
        *line: str,
        command: str = "ronna-procedure",
        environment: Mapping[str, str] = XTERM,
    ) -> None:
        self._primary, secondary = pty.openpty()
        inherited = {name: value for name, value in commands.environment.items() if name != "NO_COLOR"}
        self.process = subprocess.Popen(
            commands.line(command, *line),
            env={**inherited, **environment, "COLUMNS": "120"},
            stdin=secondary,
            stdout=secondary,
            stderr=secondary,
            preexec_fn=_lead_the_terminal,  # noqa: PLW1509 - no thread of the test runs yet
        )
        os.close(secondary)
        self.raw = self.text = ""

    def await_text(self, pattern: str) -> None:
        self.read_until(lambda: re.search(pattern, self.text, re.DOTALL) is not None)

    def read_until(self, condition: Callable[[], bool]) -> None:
        deadline = time.monotonic() + AWAITED_S
        while not condition():
            assert time.monotonic() < deadline, self.text[-2000:]
            assert self.process.poll() is None, self.text[-2000:]
            self._read()

    def type(self, text: str) -> None:
        os.write(self._primary, text.encode())

    def pauses(self) -> bool:
        """Whether it comes to a pause before it ends."""
        deadline = time.monotonic() + AWAITED_S
        while "paused> " not in self.text and self.process.poll() is None:
            assert time.monotonic() < deadline, self.text[-2000:]
            self._read()
        return "paused> " in self.text

    def rest(self) -> int:
        deadline = time.monotonic() + AWAITED_S
        while self.process.poll() is None and time.monotonic() < deadline:
            self._read()
        self._read()
        return self.process.wait(5)

    def end_by_ctrl_c(self) -> None:
        """Pause, stop the arm, end the command: each by one more Ctrl-C."""
        self.type(CTRL_C)
        self.await_text("Ctrl-C again stops the arm now")
        self.type(CTRL_C)
        self.await_text("paused> ")
        if AT_QUESTION not in self.text:  # the pause may have been met before the second one was typed
            self.type(CTRL_C)
            self.await_text(AT_QUESTION)
        self.type(CTRL_C)
        assert self.rest() == 130, self.text[-2000:]

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self._primary)

    def _read(self) -> None:
        ready, _, _ = select.select([self._primary], [], [], 0.2)
        if ready:
            try:
                self.raw += os.read(self._primary, 65536).decode(errors="replace")
            except OSError:  # the line has hung up: the command has ended
                return
            self.text = STYLE.sub("", self.raw)
