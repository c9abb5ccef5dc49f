"""A theatre started by hand, with the procedure on its file and a person who answers."""

import json
import os
import pty
import re
import select
import subprocess
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

import pytest
from run_folders import await_motion_in, run_folder
from user_commands import Commands, in_this_process, one_error

from procedures.engine.journal import JOURNAL_FILE, Entry, read_journal
from ronna_hw.errors import EXIT_REFUSED, EXIT_SAFETY_STOP
from sim.cli import app as ronna_sim

CASE_S = 100.0
PROMPT = r"Type (yes or no|done|how many mm|the patient's identifier)[^:]*: |held> "
PATIENT = "mini-4"  # scene and seed


def answer(asked: str | None, text: str) -> str:
    """What a person types who has read the text; a case that is held is left."""
    if asked is None:
        return "quit"
    if asked == "how many mm":
        return re.findall(r"moves\s+(\d+)\s+mm", text)[-1]
    return PATIENT if asked.startswith("the patient") else asked.split()[0]


@dataclass(frozen=True)
class Cell:
    """A theatre that somebody has started, a patient for it, and a person at the terminal."""

    commands: Commands
    folder: Path
    endpoints: dict[str, str]

    @property
    def case(self) -> tuple[str, ...]:
        file, patient = self.folder / "theatre" / "theatre.toml", self.folder / "patient"
        return ("--config", str(file), "--case", str(patient), "--out", str(self.folder / "runs"))

    def simulator(self, *line: str) -> None:
        control = ("--control", self.endpoints["control"])
        assert self.commands.run("ronna-sim", *line, *control).returncode == 0

    def by_hand(self, *line: str, happens: Callable[[str], None] = lambda _text: None) -> tuple[int, str]:
        """The exit code and the terminal's text of a command whose questions are answered.

        `happens` is handed the text before each answer and whenever there is more of it.
        """
        primary, secondary = pty.openpty()
        process = subprocess.Popen(
            self.commands.line("ronna-procedure", *line),
            env={**self.commands.environment, "TERM": "xterm"},
            stdin=secondary,
            stdout=secondary,
            stderr=secondary,
        )
        os.close(secondary)
        text, answered, deadline = "", 0, time.monotonic() + CASE_S
        try:
            while process.poll() is None and time.monotonic() < deadline:
                if not select.select([primary], [], [], 0.2)[0]:
                    continue
                try:
                    text += os.read(primary, 65536).decode(errors="replace")
                except OSError:
                    break
                happens(text)
                asked = [found[1] for found in re.finditer(PROMPT, text)]
                if len(asked) > answered:
                    answered += 1
                    os.write(primary, answer(asked[-1], text).encode() + b"\n")
            return process.wait(5), text
        finally:
            if process.poll() is None:
                process.kill()
                process.wait()
            os.close(primary)


@pytest.fixture
def cell(commands: Commands, tmp_path: Path) -> Iterator[Cell]:
    scene = ("--scene", "mini", "--seed", "4")
    assert commands.run("ronna-sim", "phantom", *scene, "--out", str(tmp_path / "patient")).returncode == 0
    theatre = commands.start("ronna-sim", "theatre", *scene, "--out", str(tmp_path / "theatre"))
    assert theatre.stdout is not None
    ready = json.loads(theatre.stdout.readline().removeprefix("READY "))
    try:
        yield Cell(commands, tmp_path, ready["endpoints"])
    finally:
        theatre.terminate()
        theatre.communicate(timeout=5)


@pytest.mark.slow
def test_a_person_confirms_each_value_and_exchanges_the_tool(cell: Cell) -> None:
    exchanges = 0

    def exchanged(text: str) -> None:
        nonlocal exchanges
        if text.count("Mount the surgical guide") > exchanges:
            exchanges += 1
            cell.simulator("mount", "2")

    code, text = cell.by_hand("run", *cell.case, happens=exchanged)
    assert code == 0, text[-1500:]
    assert "predicted error of" in text


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.hazard(32)
def test_after_an_emergency_stop_it_is_acknowledged_by_name_and_the_arm_goes_home(cell: Cell) -> None:
    def pressed_in_the_first_motion(text: str) -> None:
        if "first motion" in text and not is_pressed:
            Thread(target=press, daemon=True).start()
            is_pressed.append(True)

    def press() -> None:
        await_motion_in(cell.folder / "runs", "relocalization:T1")
        cell.simulator("fault", "robot emergency stop")

    is_pressed: list[bool] = []
    code, text = cell.by_hand("run", *cell.case, happens=pressed_in_the_first_motion)
    assert code == EXIT_SAFETY_STOP, text[-1500:]
    folder = run_folder(cell.folder / "runs")
    assert folder is not None
    acknowledge = ("ronna-procedure", "acknowledge", str(folder), "--by", "A. Nurse", "--json")
    for code, text in (cell.by_hand("home", str(folder)), cell.by_hand(*acknowledge[1:])):
        assert code == EXIT_REFUSED, text
        assert "emergency stop is active" in text
    cell.simulator("fault", "--clear")
    code, text = cell.by_hand("home", str(folder))
    assert code == EXIT_REFUSED
    assert "ronna-procedure acknowledge" in " ".join(text.split())
    assert list(json.loads(cell.commands.run(*acknowledge).stdout)["acknowledged"]) == ["arm"]
    code, text = cell.by_hand("home", str(folder))
    assert (code, "the arm is home" in text) == (0, True), text
    line = next(one for one in read_journal(folder / JOURNAL_FILE) if one["entry"] == Entry.ACKNOWLEDGED)
    assert line["by"] == "A. Nurse"


def test_a_theatre_that_is_not_there_cannot_exchange_its_tool() -> None:
    done = in_this_process(ronna_sim, "mount", "2", "--control", "tcp://127.0.0.1:9?token=x")
    assert done.returncode == 4
    assert one_error(done.stderr)[0].startswith("CTL-001")
