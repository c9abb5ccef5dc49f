"""A command that runs a case with a console, and how a browser enters it."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from waiting import eventually

READY_S = 60.0
CASE_S = 600.0  # only ends what has failed: a browser on a busy computer takes what the case needs
ADDRESSES = re.compile(r"^(?:step> )?CONSOLE (\{.*\})$", re.M)
MINI = ("--scene", "mini", "--seed", "3")


@dataclass
class OperatedCase:
    """A command that runs a case with a console."""

    process: subprocess.Popen[str]
    folder: Path  # of runs
    errors: Path
    output: Path
    addresses: dict[str, str] = field(default_factory=dict)

    @property
    def run(self) -> Path:
        """The folder of its run."""
        return next(one for one in self.folder.iterdir() if not one.name.startswith("."))

    @property
    def said(self) -> str:
        """On standard error so far."""
        return self.errors.read_text(encoding="utf-8")

    @property
    def console_pid(self) -> int:
        """The process of its console."""
        children = Path(f"/proc/{self.process.pid}/task").glob("*/children")
        for pid in {pid for one in children for pid in one.read_text().split()}:
            if b"console.serving" in Path(f"/proc/{pid}/cmdline").read_bytes():
                return int(pid)
        raise AssertionError("there is no console")

    def ended(self) -> int:
        """Its exit code, when it has come to its end by itself."""
        return self.process.wait(CASE_S)

    def await_addresses(self) -> None:
        eventually(lambda: bool(ADDRESSES.search(self.said)) or self.process.poll() is not None, READY_S)
        self.addresses = json.loads(ADDRESSES.findall(self.said)[0])


class OperatedCases:
    """Starts commands that run a case with a console."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.started: list[OperatedCase] = []

    def __call__(self, *arguments: str, scene: tuple[str, ...] = MINI) -> OperatedCase:
        """Start `ronna-procedure ARGUMENTS --sim SCENE --console`."""
        out = self._folder / f"runs-{len(self.started)}"
        return self._start(out, *arguments, "--sim", *scene, "--console", "--out", str(out))

    def typed(self, *arguments: str) -> OperatedCase:
        """Start `ronna-procedure ARGUMENTS`, which bring `--sim` and `--console` along."""
        out = self._folder / f"runs-{len(self.started)}"
        return self._start(out, *arguments, "--out", str(out))

    def at_terminal(self, *arguments: str) -> tuple[OperatedCase, Callable[[str], object]]:
        """As a call, by a person at a terminal; returns what types a line there."""
        out = self._folder / f"runs-{len(self.started)}"
        ours, theirs = pty.openpty()
        case = self._begun(out, *arguments, "--sim", *MINI, "--console", "--out", str(out), terminal=theirs)
        os.close(theirs)
        threading.Thread(target=_keep, args=(ours, case.errors), daemon=True).start()
        case.await_addresses()
        return case, lambda line: os.write(ours, line.encode() + b"\n")

    def resume(self, case: OperatedCase) -> OperatedCase:
        """Start `ronna-procedure resume RUN --console` for a case that was left."""
        return self._start(case.folder, "resume", str(case.run), "--console")

    def without_console(self, scene: tuple[str, ...] = MINI) -> OperatedCase:
        """The same case with nothing that shows it, answered by the script; it has come to its end."""
        out = self._folder / f"runs-{len(self.started)}"
        case = self._begun(out, "run", "--json", "--sim", *scene, "--out", str(out))
        assert case.ended() == 0, case.said
        return case

    def _start(self, runs: Path, *arguments: str) -> OperatedCase:
        case = self._begun(runs, *arguments)
        case.await_addresses()
        return case

    def _begun(self, runs: Path, *arguments: str, terminal: int | None = None) -> OperatedCase:
        number = len(self.started)
        errors, output = (self._folder / f"{name}-{number}" for name in ("errors", "output"))
        line = [sys.executable, "-P", "-m", "procedures.cli.procedure", *arguments]
        with errors.open("w") as error, output.open("w") as written:
            streams = (subprocess.DEVNULL, written, error) if terminal is None else (terminal,) * 3
            process = subprocess.Popen(
                line, stdin=streams[0], stdout=streams[1], stderr=streams[2], text=True
            )
        case = OperatedCase(process, runs, errors, output)
        self.started.append(case)
        return case


@contextmanager
def operated_cases(folder: Path) -> Iterator[OperatedCases]:
    """Each case that was started ends with the block."""
    cases = OperatedCases(folder)
    try:
        yield cases
    finally:
        for case in cases.started:
            if case.process.poll() is None:
                case.process.send_signal(signal.SIGTERM)
            case.process.wait(30)


@contextmanager
def reviewed(run: Path, errors: Path) -> Iterator[str]:
    """`ronna-console RUN`: its address."""
    with errors.open("w") as file:
        line = [sys.executable, "-P", "-m", "console.command", str(run)]
        process = subprocess.Popen(line, stderr=file, stdin=subprocess.DEVNULL)
    try:
        eventually(lambda: "CONSOLE {" in errors.read_text(), READY_S)
        yield json.loads(re.findall(r"CONSOLE (\{.*\})", errors.read_text())[0])["url"]
    finally:
        process.terminate()
        process.wait(10)


def _keep(terminal: int, file: Path) -> None:
    """What is shown on a terminal, until its program ends."""
    with file.open("ab", buffering=0) as kept, contextlib.suppress(OSError):
        while shown := os.read(terminal, 65536):
            kept.write(shown.replace(b"\r", b""))


def enter(page: Any, address: str) -> None:
    """Open a console and wait until it shows something."""
    page.goto(address)
    page.wait_for_selector("#clock[data-beat]")
