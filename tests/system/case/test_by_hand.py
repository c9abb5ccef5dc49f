"""A theatre started by hand, with the procedure on its file and a person who answers."""

import io
import json
import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from threading import Thread

import pytest
from dicom_stand import free_port, needs_orthanc, orthanc
from person import Person
from run_folders import await_motion_in, run_folder
from user_commands import Commands, in_this_process, one_error
from waiting import HANG_LIMIT_S

from procedures.cli.dicom import app as ronna_dicom
from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from procedures.runs.request_file import read_request
from ronna_hw.errors import EXIT_REFUSED, EXIT_SAFETY_STOP
from sim.cli import app as ronna_sim

PATIENT = "mini-4"  # scene and seed
END_OF_INPUT = "\x04"


@dataclass(frozen=True)
class Cell:
    """A theatre that somebody has started, a patient for it, and a person at the terminal."""

    commands: Commands
    folder: Path

    @property
    def case(self) -> tuple[str, ...]:
        return ("--config", "theatre/theatre.toml", "--case", "patient", "--out", "runs")

    def simulator(self, *line: str) -> None:
        assert self.commands.run("ronna-sim", *line).returncode == 0

    def by_hand(self, *line: str, happens: Callable[[str], None] = lambda _text: None) -> tuple[int, str]:
        """The exit code and the terminal's text of a command whose questions are answered."""
        person = Person(self.commands, self.folder, PATIENT)
        return person.does(shlex.join(["ronna-procedure", *line]), happens=happens)


@pytest.fixture
def cell(commands: Commands, tmp_path: Path) -> Iterator[Cell]:
    scene = ("--scene", "mini", "--seed", "4")
    assert commands.run("ronna-sim", "phantom", *scene, "--out", str(tmp_path / "patient")).returncode == 0
    theatre = commands.start("ronna-sim", "theatre", *scene, "--out", str(tmp_path / "theatre"))
    assert theatre.stdout is not None
    ready = json.loads(theatre.stdout.readline().removeprefix("READY "))
    commands.environment["RONNA_CONTROL"] = ready["endpoints"]["control"]
    try:
        yield Cell(commands, tmp_path)
    finally:
        theatre.terminate()
        theatre.communicate(timeout=HANG_LIMIT_S)


@pytest.mark.slow
@pytest.mark.hazard(36)
def test_a_simulated_case_is_driven_by_answers_and_words_alone_whatever_was_mistyped(
    commands: Commands, tmp_path: Path
) -> None:
    mistakes = {
        "yes or no": ["y\n", "help\n", "YES please\n"],
        "'mount 2' or nobody": ["drill\n", "mount\n", "mount 9\n", "mount 1\n"],
        "drill or nobody": ["insert\n"],
        "skin or nobody": [END_OF_INPUT],  # the question comes next
        "yes or 'hold the guide'": [END_OF_INPUT],
        "held": ["insert\n", "Resume\n"],
    }
    person = Person(commands, tmp_path, "mini-3", mistakes)
    code, text = person.does("ronna-procedure run --sim --ask --scene mini --seed 3 --out runs")
    assert code == 0, text[-1500:]
    assert not any(mistakes.values()), "every mistake was made"
    said = " ".join(text.split())
    for words in (
        "every question of a real case is asked here",
        "'y' is not an answer: type yes or no in full",
        "No answer within 300 s counts as 'no'",
        "'drill' is not due now: type 'mount 2' or nobody",
        "mount needs the number of a tool",
        "no tool 9",
        "Done: tool 1 is mounted",
        "the wrong tool is mounted: mount again",
        "'insert' is not due now: type drill or nobody",
        "'insert' is manual work, which is typed when the case asks for it",
        "Work through the guide (at_target:T1): instrument within",
        "error of the needle tip against truth",
    ):
        assert words in said, words
    folder = run_folder(tmp_path / "runs")
    assert folder is not None
    journal = read_journal(folder / JOURNAL_FILE)
    answered = {str(one["topic"]) for one in journal if one["entry"] == Entry.CONFIRMATION}
    assert {"patient", "first_motion", "registration:T1", "tool_change", "drill:T1", "park"} <= answered
    assert read_request(folder).ask, "and a resumed case asks again"


@pytest.mark.slow
@pytest.mark.timeout(300)
@pytest.mark.hazard(32)
def test_after_an_emergency_stop_is_acknowledged_by_name_the_arm_goes_home(cell: Cell) -> None:
    def pressed_in_the_first_motion(text: str) -> None:
        if "then as listed" in text and not is_pressed:
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
    pressed = {("home", str(folder)): "emergency stop: pressed", acknowledge[1:]: "emergency stop is active"}
    for words, said in pressed.items():
        code, text = cell.by_hand(*words)
        assert code == EXIT_REFUSED, text
        assert said in text
    cell.simulator("fault", "--clear")
    code, text = cell.by_hand("home", str(folder))
    assert code == EXIT_REFUSED
    assert "ronna-procedure acknowledge" in " ".join(text.split())
    assert list(json.loads(cell.commands.run(*acknowledge).stdout)["acknowledged"]) == ["arm"]
    code, text = cell.by_hand("home", str(folder))
    assert (code, "the arm is home" in text) == (0, True), text
    line = next(one for one in read_journal(folder / JOURNAL_FILE) if one["entry"] == Entry.ACKNOWLEDGED)
    assert line["by"] == "A. Nurse"


@needs_orthanc
@pytest.mark.slow
@pytest.mark.timeout(600)  # only ends what hangs
@pytest.mark.hazard(9)
def test_a_case_runs_on_a_ct_that_was_fetched_from_an_archive_and_read_back(
    cell: Cell, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours, inbox, case = free_port(), cell.folder / "inbox", cell.folder / "fetched"
    with orthanc(cell.folder / "orthanc", ours) as archive:
        peer = f"ORTHANC@127.0.0.1:{archive.port}"
        assert in_this_process(ronna_dicom, "send", peer, cell.folder / "patient/ct").returncode == 0
        found = in_this_process(ronna_dicom, "find", peer, "--patient", PATIENT, "--json")
        (row,) = json.loads(found.stdout)["series"]
        got = in_this_process(
            ronna_dicom, "fetch", peer, row["study"], row["series"], "--out", inbox, "--port", ours
        )
        assert got.returncode == 0, got.stderr
        name = json.loads(got.stdout)["name"]
        monkeypatch.setattr("sys.stdin", io.StringIO(f"{PATIENT}\n"))
        taken = in_this_process(ronna_dicom, "take", inbox, name, "--case", case)
        assert taken.returncode == 0, taken.stderr
        (case / "plan.toml").write_bytes((cell.folder / "patient/plan.toml").read_bytes())
        code, text = cell.by_hand(
            "run", "--config", "theatre/theatre.toml", "--case", "fetched", "--out", "runs"
        )
        assert code == 0, text[-1500:]
        folder = run_folder(cell.folder / "runs")
        assert folder is not None
        export = cell.folder / "export"
        assert (
            cell.commands.run("ronna-procedure", "export", str(folder), "--out", str(export)).returncode == 0
        )
        refused = in_this_process(ronna_dicom, "send", peer, export)
        assert (refused.returncode, "DCM-014" in refused.stderr) == (EXIT_REFUSED, True), (
            "it names no patient"
        )
        assert len(archive.get("/patients")) == len(archive.get("/studies")) == 1


def test_the_mount_command_reports_an_unreachable_theatre() -> None:
    done = in_this_process(ronna_sim, "mount", "2", "--control", "tcp://127.0.0.1:9?token=x")
    assert done.returncode == 4
    assert one_error(done.stderr)[0].startswith("CTL-001")


def test_the_work_command_accepts_negative_joint_values() -> None:
    said = "work gauge -40 -75 99 0 66 180 60 --control tcp://127.0.0.1:9?token=x"
    done = in_this_process(ronna_sim, *said.split())
    assert done.returncode == 4
    assert one_error(done.stderr)[0].startswith("CTL-001")
