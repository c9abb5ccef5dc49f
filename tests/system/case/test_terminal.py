"""The case on a terminal, as a person sees it: live progress, pause, stop."""

import fcntl
import os
import pty
import re
import select
import subprocess
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from user_commands import Commands

AWAITED_S = 100.0
AT_QUESTION = "the arm rests; Ctrl-C again ends the command"
CTRL_C = "\x03"  # typed: the terminal signals every process of its foreground group
STYLE = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]")  # colours and cursor moves


def _lead_the_terminal() -> None:
    """Make the new process the leader of a session whose terminal is its standard input."""
    os.setsid()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


class Terminal:
    """A pseudo-terminal with the command on it."""

    def __init__(self, commands: Commands, out: Path, *options: str) -> None:
        self._primary, secondary = pty.openpty()
        self.process = subprocess.Popen(
            commands.line(
                "ronna-procedure",
                "run",
                "--sim",
                "--scene",
                "mini",
                "--seed",
                "3",
                "--out",
                str(out),
                *options,
            ),
            env={**commands.environment, "TERM": "xterm", "COLUMNS": "120"},
            stdin=secondary,
            stdout=secondary,
            stderr=secondary,
            preexec_fn=_lead_the_terminal,  # noqa: PLW1509 - no thread of the test runs yet
        )
        os.close(secondary)
        self._raw = self.text = ""

    def await_text(self, pattern: str) -> None:
        deadline = time.monotonic() + AWAITED_S
        while not re.search(pattern, self.text, re.DOTALL):
            assert time.monotonic() < deadline, self.text[-2000:]
            assert self.process.poll() is None, self.text[-2000:]
            self._read()

    def type(self, text: str) -> None:
        os.write(self._primary, text.encode())

    def rest(self) -> int:
        deadline = time.monotonic() + AWAITED_S
        while self.process.poll() is None and time.monotonic() < deadline:
            self._read()
        self._read()
        return self.process.wait(5)

    def close(self) -> None:
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()
        os.close(self._primary)

    def _read(self) -> None:
        ready, _, _ = select.select([self._primary], [], [], 0.2)
        if ready:
            try:
                self._raw += os.read(self._primary, 65536).decode(errors="replace")
            except OSError:  # the line has hung up: the command has ended
                return
            self.text = STYLE.sub("", self._raw)


@pytest.fixture
def terminal(commands: Commands, tmp_path: Path) -> Iterator[Terminal]:
    opened = Terminal(commands, tmp_path / "runs")
    yield opened
    opened.close()


@pytest.mark.slow
def test_one_ctrl_c_pauses_and_only_the_listed_words_continue(terminal: Terminal) -> None:
    terminal.await_text("✓ ct_import")
    terminal.type(CTRL_C)
    terminal.await_text("Paused: Ctrl-C")
    terminal.type("\n")
    terminal.await_text("(paused> .*){2}")
    terminal.type("stop\n")
    terminal.await_text("(paused> .*){3}")
    terminal.type("continue\n")
    assert terminal.rest() == 0
    assert "error mm" in terminal.text
    assert len(re.findall(r"report /\S+", terminal.text)) == 1


def test_repeated_ctrl_c_reports_the_arm_at_rest_and_then_ends_the_command(
    terminal: Terminal,
) -> None:
    terminal.await_text("✓ path_check")
    terminal.type(CTRL_C)
    terminal.await_text("Ctrl-C again stops the arm now")
    terminal.type(CTRL_C)
    terminal.await_text("paused> ")
    if AT_QUESTION not in terminal.text:  # the pause may have been met before the second one was typed
        terminal.type(CTRL_C)
        terminal.await_text(AT_QUESTION)
    terminal.type(CTRL_C)
    assert terminal.rest() == 130
    assert "ronna-procedure resume " in terminal.text
    assert "Traceback" not in terminal.text


@pytest.mark.slow
def test_abort_at_the_pause_ends_with_its_own_exit_code(terminal: Terminal) -> None:
    terminal.await_text("✓ ct_import")
    terminal.type(CTRL_C)
    terminal.await_text("paused> ")
    terminal.type("abort\n")
    assert terminal.rest() == 7
    assert "PRO-004" in terminal.text


@pytest.mark.slow
def test_a_failed_step_leaves_the_case_at_a_prompt_from_which_it_can_go_home(
    commands: Commands, tmp_path: Path
) -> None:
    answers = tmp_path / "answers.toml"
    answers.write_text('[answers]\n"approach:T1" = "no"\n')
    terminal = Terminal(commands, tmp_path / "runs", "--answers", str(answers))
    try:
        terminal.await_text("held> ")
        assert "PRO-002" in terminal.text
        terminal.type("home\n")
        terminal.await_text("the arm is parked")
        terminal.type("quit\n")
        assert terminal.rest() == 7
        assert terminal.text.count("PRO-002 ") == 1  # with its advice, when it held the case; not at the end
    finally:
        terminal.close()
