"""A person at a terminal who reads what is asked, does with simulated hands what is told, and answers.

With `--ask` the hands are words, which are asked for like answers.
"""

from __future__ import annotations

import os
import pty
import re
import select
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

from user_commands import Commands

ASKED = re.compile(r"Type ([^:\n]+): |held> ")
SHOWN = re.compile(r"You read off [^:\n]+: ([^\r\n]+)")  # by what a typed word has done
TOLD = re.compile(r"In the simulated room: (ronna-sim [^\r\n]+?)(?: --control .*)?\r?\n")
HANDS_S = 30.0


@dataclass(frozen=True)
class Person:
    """Somebody in a folder with a terminal; `RONNA_CONTROL` in the environment is their hands."""

    commands: Commands
    folder: Path
    patient: str  # on the wristband
    mistakes: dict[str, list[str]] = field(default_factory=dict)  # said first, by what is asked; spent

    def does(
        self, line: str, *, limit_s: float = 300.0, happens: Callable[[str], None] = lambda _text: None
    ) -> tuple[int, str]:
        """The exit code and the terminal's text of a line of a shell whose questions are answered.

        `happens` is handed the text whenever there is more of it, before anything is answered.
        """
        primary, secondary = pty.openpty()
        path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        process = subprocess.Popen(
            ["bash", "-c", line],
            cwd=self.folder,
            env={**self.commands.environment, "TERM": "xterm", "PATH": path},
            stdin=secondary,
            stdout=secondary,
            stderr=secondary,
        )
        os.close(secondary)
        text, answered, done = "", 0, 0
        read_off: list[str] = []
        deadline_s = time.monotonic() + limit_s
        try:
            while process.poll() is None and time.monotonic() < deadline_s:
                if not select.select([primary], [], [], 0.2)[0]:
                    continue
                try:
                    text += os.read(primary, 65536).decode(errors="replace")
                except OSError:
                    break
                happens(text)
                said, asked = TOLD.findall(text), [found[1] for found in ASKED.finditer(text)]
                if len(asked) <= answered:
                    continue
                for hand in said[done:]:  # what stands before the question is done before it is answered
                    read_off += self.hands(hand)
                answered, done = len(asked), len(said)
                os.write(primary, self._answer(asked[-1], text, read_off).encode())
            return process.wait(5), text
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            os.close(primary)

    def hands(self, line: str) -> list[str]:
        """Do what a terminal tells; what was read off, line by line."""
        name, *words = line.split()
        done = self.commands.run(name, *words, timeout_s=HANDS_S)
        assert done.returncode == 0, f"{line}: {done.stderr}"
        return done.stdout.split("\n")[:-1]

    def _answer(self, asked: str | None, text: str, read_off: list[str]) -> str:
        """Return the next mistake planned for this question, or the right answer."""
        if mistakes := self.mistakes.get(asked or "held"):
            return mistakes.pop(0)
        return f"{self._right_answer(asked, text, read_off)}\n"

    def _right_answer(self, asked: str | None, text: str, read_off: list[str]) -> str:
        """The first of the answers, what is read back, what was read off; a case that is held is left."""
        if asked is None:
            return "quit"
        if asked.startswith("how many mm"):
            return re.findall(r"moves\s+(\d+)\s+mm", text)[-1]
        if asked.startswith("the patient"):
            return self.patient
        if asked.startswith("wait, continue") and asked in text[: text.rindex("Type ")]:
            return "continue"  # it did not help to wait
        if " or " in asked:
            return re.split(r", | or ", asked)[0]
        if shown := SHOWN.findall(text):
            return f"{shown[-1]}"
        assert read_off, f"nothing was read off for: {asked}"
        return read_off.pop(0)
