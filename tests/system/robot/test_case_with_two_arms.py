"""A whole case with two arms: bases, motions in turn, insertion by the assistant, and what happens to it."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from collections.abc import Callable, Sequence
from itertools import groupby, pairwise
from pathlib import Path
from typing import NamedTuple

import pytest
from run_folders import run_folder
from user_commands import Commands
from waiting import eventually

from procedures.journal.journal import JOURNAL_FILE, Entry, Line, read_journal
from ronna_hw.clock import open_clock
from ronna_hw.control_port import ask_control_port
from ronna_hw.errors import EXIT_RECOVERY_NEEDED, EXIT_REFUSED, EXIT_SAFETY_STOP
from ronna_hw.host.child_process import command
from ronna_hw.roles import ASSISTANT, MASTER
from ronna_hw.wire.room_tasks import EMPTY
from sim.world.running import find_running

pytestmark = [pytest.mark.slow, pytest.mark.timeout(1800)]

LIMIT_S = 900.0
CASE = ("--sim", "--dual", "--scene", "mini", "--seed", "0", "--json")
UR = ("--assistant-arm", "ur5e")
TWO_UR = ("--arm", "ur5e", *UR)
IN_BORE_S = (
    6.0  # theatre time from the begin of the insertion, or of the withdrawal, at which the tip is there
)
SIGMAS = 4.0  # of the stated error of a target
Happening = Callable[[Commands, Path], None]


@pytest.mark.parametrize("arms", [(), TWO_UR], ids=["two of KUKA", "two of Universal Robots"])
def test_the_assistant_inserts_the_instrument_both_arms_go_home_and_the_run_replays(
    tmp_path: Path, arms: tuple[str, ...]
) -> None:
    ended = subprocess.run(
        command("procedures.cli.procedure", "run", *CASE, *arms, "--out", str(tmp_path)),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    (run,) = tmp_path.iterdir()
    (bases,) = (run / "records").glob("*-base_to_base.json")
    assert json.loads(bases.read_text())["payload"]["error_mm"] <= 0.1
    assert [what for arm, what in motions(journal_of(run)) if arm == ASSISTANT][-3:] == [
        "insert",
        "withdraw",
        "home",
    ]
    subjects = [str(line["subject"]) for line in journal_of(run) if line["entry"] == Entry.CONFIRMATION]
    assert "Drive the master home?" in subjects
    assert not [subject for subject in subjects if "the arm " in subject]
    page = (run / "report.html").read_text()
    for way in ("guide in", "instrument in", "instrument out", "guide out"):
        assert len(re.findall(rf'<td data-label="way" class="point">{way}</td>', page)) == 1
    for arm, carried in {MASTER: "guide|stereo head", ASSISTANT: "holder of the assistant"}.items():
        listed = re.findall(rf'<td data-label="robot link">(?:{carried})</td>', page)
        assert len(listed) == ended_streams(run, arm), arm
    again = subprocess.run(
        command("procedures.cli.procedure", "replay", str(run)),
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert again.returncode == 0, again.stderr


def ended_streams(run: Path, arm: str) -> int:
    """Count the streams of an arm that ended in a run, by its log."""
    lines = map(json.loads, (run / "log.jsonl").read_text().splitlines())
    return sum(
        line.get("device") == f"robot.{arm}" and line["event"] == "configured" and "cycles" in line
        for line in lines
    )


class Trouble(NamedTuple):
    """Fault during the insertion or the withdrawal, and how the case must stop."""

    during: str  # motion of the assistant
    happens: Happening
    code: str
    exit_code: int
    options: tuple[str, ...] = ()


def signalled(number: signal.Signals) -> Happening:
    """Signal the simulator of the assistant."""

    def happen(commands: Commands, _folder: Path) -> None:
        (simulator,) = [one for one in commands.survivors() if is_simulator_of(ASSISTANT, one)]
        os.kill(simulator, number)

    return happen


def is_simulator_of(role: str, process: int) -> bool:
    words = Path(f"/proc/{process}/cmdline").read_bytes().decode().split("\0")
    return "sim.cli" in words and ("--role", role) in pairwise(words)


def injected(line: str) -> Happening:
    """Inject a fault into the theatre of the run."""

    def happen(_commands: Commands, folder: Path) -> None:
        endpoints = find_running(str(folder / "theatre")).ready["endpoints"]
        ask_control_port(endpoints["control"], "fault", line=line)

    return happen


TROUBLES = (
    pytest.param(
        Trouble("insert", signalled(signal.SIGSTOP), "DUAL-001", EXIT_REFUSED),
        id="frozen in the bore",
        marks=pytest.mark.hazard(58),
    ),
    pytest.param(
        Trouble("withdraw", injected("assistant robot emergency stop"), "DUAL-001", EXIT_REFUSED),
        id="emergency stop on the way out",
        marks=pytest.mark.hazard(59),
    ),
    pytest.param(
        Trouble("insert", injected("assistant ur load axial 25 N"), "ARM-015", EXIT_SAFETY_STOP, UR),
        id="pushed back in the bore",
        marks=pytest.mark.hazard(56),
    ),
)


@pytest.mark.parametrize("trouble", TROUBLES)
def test_a_case_that_stopped_on_the_axis_is_resumed_straight_out_of_it_and_ends(
    commands: Commands, tmp_path: Path, trouble: Trouble
) -> None:
    process = commands.start("ronna-procedure", "run", *CASE, *trouble.options, "--out", str(tmp_path))
    folder = await_assistant(tmp_path, trouble.during)
    trouble.happens(commands, folder)
    _, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == trouble.exit_code, said
    stopped = journal_of(folder)
    assert stopped[-1]["code"] == trouble.code
    assert stopped[-1]["instrument_in"] == "T1"
    failed = next(number for number, line in enumerate(stopped) if line["entry"] == Entry.FAILED)
    assert motions(stopped[failed:]) == []
    done = commands.run("ronna-procedure", "resume", str(folder), "--accept", "--json", timeout_s=LIMIT_S)
    assert done.returncode == 0, done.stderr
    out = [(ASSISTANT, "withdraw"), (ASSISTANT, "home"), (MASTER, "withdraw"), (MASTER, "home")]
    assert way_of(journal_of(folder)[len(stopped) :])[: len(out)] == out
    (target,) = json.loads(done.stdout)["targets"]
    assert target["application_error_mm"] < SIGMAS * target["predicted_tre_mm"]


@pytest.mark.hazard(64)
def test_an_assistant_whose_cart_was_pushed_in_the_bore_leads_nothing_out_in_a_resumed_case(
    commands: Commands, tmp_path: Path
) -> None:
    process = commands.start("ronna-procedure", "run", *CASE, "--out", str(tmp_path))
    folder = await_assistant(tmp_path, "insert")
    injected("room move cart 2 0 1.5 0 mm 0 deg in 0.1 s")(commands, folder)
    _, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == EXIT_REFUSED, said
    stopped = journal_of(folder)
    assert stopped[-1]["code"] == "PRO-054"
    for order in ("resume", "home"):
        refused = commands.run("ronna-procedure", order, str(folder), "--accept", timeout_s=LIMIT_S)
        assert refused.returncode == EXIT_RECOVERY_NEEDED, refused.stderr
        assert "PRO-054: the tracker sees the assistant beside the axis of T1" in refused.stderr
    assert motions(journal_of(folder)[len(stopped) :]) == []


def await_journal(out: Path, pick: Callable[[list[Line]], Line | None]) -> tuple[Path, Line]:
    """Return the folder of the run and the line of its journal that is picked, once it is written."""
    found: list[Line] = []

    def is_written() -> bool:
        folder = run_folder(out)
        if folder is not None and (folder / JOURNAL_FILE).exists():
            picked = pick(journal_of(folder))
            found.extend([] if picked is None else [picked])
        return bool(found)

    eventually(is_written, LIMIT_S)
    folder = run_folder(out)
    assert folder is not None
    return folder, found[0]


def await_assistant(out: Path, what: str) -> Path:
    """Return the folder of the run once the assistant is amid that motion on its axis."""

    def begins(lines: list[Line]) -> Line | None:
        return next((one for one in lines if one.get("arm") == ASSISTANT and one.get("what") == what), None)

    folder, begun = await_journal(out, begins)
    clock = open_clock(find_running(str(folder / "theatre")).ready["endpoints"]["clock"])
    amid_s = float(str(begun["theatre_time_s"])) + (IN_BORE_S if what == "insert" else 1.0)
    eventually(lambda: clock.now_s() >= amid_s)
    return folder


def journal_of(run: Path) -> list[Line]:
    return list(read_journal(run / JOURNAL_FILE))


def motions(journal: Sequence[Line]) -> list[tuple[str, str]]:
    """Each motion in a journal: of which arm, and what."""
    return [(str(line["arm"]), str(line["what"])) for line in journal if line["entry"] == Entry.MOTION]


def way_of(journal: Sequence[Line]) -> list[tuple[str, str]]:
    """The motions, however a way home was found: where the direct one is not clear, back as the arm came."""
    return [one for one, _ in groupby(motion for motion in motions(journal) if motion[1] != "back")]


@pytest.mark.hazard(63)
def test_an_instrument_in_the_holder_is_taken_out_before_the_assistant_goes_home(
    commands: Commands, tmp_path: Path
) -> None:
    """Stopped over the guide, the instrument is not in it yet: no question about the guide would be asked."""
    process = commands.start("ronna-procedure", "run", *CASE, "--out", str(tmp_path))

    def moves_with_it(lines: list[Line]) -> Line | None:
        held = [number for number, line in enumerate(lines) if line["entry"] == Entry.HELD]
        moves = (line for line in lines[held[0] :] if line["entry"] == Entry.MOTION) if held else iter(())
        return next(moves, None)

    folder, _ = await_journal(tmp_path, moves_with_it)
    injected("assistant robot emergency stop")(commands, folder)
    _, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == EXIT_REFUSED, said
    stopped = journal_of(folder)
    assert "instrument_in" not in stopped[-1]
    shown = commands.run("ronna-procedure", "show", str(folder), timeout_s=LIMIT_S)
    assert "the instrument for T1 was still in the assistant's holder" in shown.stdout
    done = commands.run("ronna-procedure", "resume", str(folder), "--accept", "--json", timeout_s=LIMIT_S)
    assert done.returncode == 0, done.stderr
    after = journal_of(folder)[len(stopped) :]
    emptied = next(number for number, line in enumerate(after) if line.get("task") == EMPTY)
    assert motions(after[:emptied]) == []
    assert (ASSISTANT, "home") in motions(after[emptied:])
