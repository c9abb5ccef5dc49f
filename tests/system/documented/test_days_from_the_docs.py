"""Three users' days, played from the documentation alone: its commands, and a person who answers prompts."""

from __future__ import annotations

import contextlib
import json
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import pytest
from console_script import ConsoleScript
from documented import commands_of
from person import SHOWN, Person
from run_folders import await_motion_in
from user_commands import Commands

from ronna_hw.errors import EXIT_NOT_FOUND, EXIT_REFUSED, EXIT_SAFETY_STOP
from ronna_hw.host.child_process import ChildProcess, command
from sim.world.running import variables_of

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]
CONSOLE = re.compile(r"CONSOLE (\{.*\})")
PICTURE_PERIOD_S = 0.15  # host time between two looks at the page
THEATRE = re.compile(r"^ronna-sim theatre (.+)$", re.MULTILINE)
ENDED = re.compile(r"^exit code (\d+)\r?$", re.MULTILINE)
PATIENT = "mini-4"
SURGEON = "Dr Test"
ROOT = Path(__file__).resolve().parents[3]


class Day:
    """A page, the theatre that it has started in another terminal, and a person who follows it."""

    def __init__(self, page: str, commands: Commands, folder: Path) -> None:
        self.page = ROOT / page
        self.lines = commands_of(page)
        self.folder = folder
        self.person = Person(commands, folder, PATIENT)

    def theatre(self) -> ChildProcess:
        """What the page has in a terminal of its own."""
        found = THEATRE.search(self.page.read_text())
        assert found is not None
        words = [word for word in found[1].split() if word != "--detach"]  # it ends with the test
        out = words.index("--out") + 1
        words[out] = str(self.folder / words[out])
        return ChildProcess("ronna-sim theatre", command("sim.cli", "theatre", *words))

    def to(self, beginning: str, happens: Callable[[str], None] = lambda _text: None) -> tuple[int, str]:
        """Follow the page up to and with the next line that begins so: its exit code, and what it said."""
        while self.lines:
            line = self.lines.pop(0)
            code, text = self.person.does(line, happens=happens)
            assert code == 0, f"{line}\n{text[-3000:]}"
            if line.startswith(beginning):
                ended = ENDED.search(text)
                return (int(ended[1]) if ended else 0), text
        raise AssertionError(f"the page has no line {beginning}")


class Surgeon:
    """Answers at the console whose URL a terminal shows; the person at the terminal does the manual work."""

    def __init__(self) -> None:
        self._text = ""
        self._answering = False
        self.answered: set[str] = set()  # topics

    def reads(self, text: str) -> None:
        """What the terminal shows so far."""
        self._text = text
        found = CONSOLE.search(text)
        if found is not None and not self._answering:
            self._answering = True
            Thread(target=self._answer_all, args=(json.loads(found[1])["url"],), daemon=True).start()

    def _answer_all(self, address: str) -> None:
        script, typed = ConsoleScript(address), 0
        assert script.order("claim", name=SURGEON) == ""
        with contextlib.suppress(OSError):  # the console ends with the case
            while not (state := script.state())["outcome"]:
                called_out = SHOWN.findall(self._text)
                asked = state["question"]
                time.sleep(PICTURE_PERIOD_S)
                if asked is None and state["waiting"] and state["upcoming"]:
                    script.order("resume", upcoming=state["upcoming"])
                if asked is None or (asked["reads"] and len(called_out) == typed):
                    continue
                readings = {"readings": list(map(float, called_out[-1].split()))} if asked["reads"] else {}
                if not script.answer(asked, PATIENT, **readings):
                    self.answered.add(asked["topic"])
                    typed = len(called_out)


@pytest.fixture
def lab(commands: Commands, tmp_path: Path) -> Iterator[Day]:
    day = Day("docs/tutorial/first-day-in-a-lab.md", commands, tmp_path)
    with day.theatre() as theatre:
        commands.environment |= variables_of(theatre.ready)
        yield day


def test_the_lab_engineer_gets_from_a_cell_full_of_faults_to_a_finished_case(lab: Day) -> None:
    code, text = lab.to("ronna-procedure doctor")
    assert code == EXIT_NOT_FOUND
    said = " ".join(text.split())
    for what in ("emergency stop", "NDI-022", "GEV-004", "CAL-001"):
        assert what in said, text
    code, text = lab.to("ronna-procedure doctor")
    assert code == EXIT_NOT_FOUND
    assert "NDI-022" not in text
    assert "STE-010" in text
    assert "calibrate tool-tip" in " ".join(text.split())
    code, text = lab.to("ronna-procedure run")
    assert code == EXIT_REFUSED, text
    assert "CAL-001" in text
    assert "held>" not in text
    assert not (lab.folder / "runs").exists()
    lab.to("ronna-procedure calibrate tracker-frame")
    lab.to("ronna-procedure calibrate tool-tip")
    assert lab.to("ronna-procedure doctor")[0] == 0
    assert lab.to("ronna-procedure run")[0] == 0
    assert lab.to("ronna-procedure verify")[0] == 0
    assert not lab.lines
    assert list(lab.folder.glob("runs/*/report.html"))


@contextmanager
def day_of(page: str, commands: Commands, folder: Path) -> Iterator[Day]:
    """The day of a page that uses the theatre's own file."""
    day = Day(page, commands, folder)
    with day.theatre() as theatre:
        commands.environment |= variables_of(theatre.ready)
        yield day


@pytest.fixture
def rehearsal(commands: Commands, tmp_path: Path) -> Iterator[Day]:
    with day_of("docs/tutorial/rehearsal-with-a-surgeon.md", commands, tmp_path) as day:
        yield day


@pytest.fixture
def student(commands: Commands, tmp_path: Path) -> Iterator[Day]:
    with day_of("docs/how-to/research/raw-readings.md", commands, tmp_path) as day:
        yield day


def from_a_bad_morning(day: Day) -> None:
    """The doctor names everything that is wrong, and is content once the page has put it right."""
    code, text = day.to("ronna-procedure doctor")
    assert code == EXIT_NOT_FOUND
    said = " ".join(text.split())
    for what in ("emergency stop", "NDI-022", "STE-010", "CAL-001"):
        assert what in said, text
    code, text = day.to("ronna-procedure doctor")
    assert code == 0, text


def test_the_clinical_engineer_rehearses_a_stop_and_finishes_the_case(rehearsal: Day) -> None:
    from_a_bad_morning(rehearsal)
    case, stop = rehearsal.lines[:2]
    del rehearsal.lines[:2]
    assert case.startswith("ronna-procedure run")
    assert "emergency stop" in stop
    pressed: list[Thread] = []

    def press() -> None:
        await_motion_in(rehearsal.folder / "runs", "relocalization:T1")
        rehearsal.person.does(stop)

    def at_the_first_motion(text: str) -> None:
        if "then as listed" in text and not pressed:
            pressed.append(Thread(target=press, daemon=True))
            pressed[0].start()

    _, text = rehearsal.person.does(case, happens=at_the_first_motion)
    ended = ENDED.search(text)
    assert ended is not None, text[-2000:]
    assert int(ended[1]) == EXIT_SAFETY_STOP, text[-3000:]
    pressed[0].join()
    surgeon = Surgeon()
    code, text = rehearsal.to("ronna-procedure resume", happens=surgeon.reads)
    assert code == 0, text[-2000:]
    assert {"resume", "tool_check", "reading", "at_target:T1"} <= surgeon.answered
    assert rehearsal.to("ronna-procedure verify")[0] == 0
    rehearsal.to("ronna-procedure report")
    (report,) = rehearsal.folder.glob("runs/*/report.html")
    for name in ("A. Nurse", SURGEON):
        assert name in report.read_text()


def test_the_doctoral_student_keeps_the_readings_of_a_theatre_that_was_not_ready(student: Day) -> None:
    from_a_bad_morning(student)
    assert student.to("ronna-procedure run")[0] == 0
    assert student.to("ronna-procedure verify")[0] == 0
    assert not student.lines
    assert list(student.folder.glob("lab-runs/*/raw/pictures/*.png"))
