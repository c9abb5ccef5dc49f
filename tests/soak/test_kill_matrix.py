"""Kills at every journal line of a mini case and at ten of a full one, and power cuts at some of them.

A program that is halted has written what one that is killed there has written: what it still holds in memory
is in no file. The world is kept as the theatre keeps it when the program that started it has died.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import halted_program
import pytest
from kills import LARGEST_CHANGE_MM, Killed, reopen_run
from run_folders import records_of, run_folder
from shared_by_workers import made_once
from user_commands import Commands, in_this_process

from procedures.cli.procedure import app as ronna_procedure
from procedures.journal.journal import BLOCK_BYTES, JOURNAL_FILE
from ronna_hw.evidence.journal_reading import read_chain
from sim.cli import app as ronna_sim
from sim.world.saved_world import save_world
from sim.world.world import World

pytestmark = [pytest.mark.soak, pytest.mark.timeout(600)]

BEING_WRITTEN = "being_written.json"
REST_LIMIT_S = 0.3  # that the theatre gives an arm on its way


@dataclass(frozen=True)
class Snapshot:
    """Run of a program that was killed at a journal line, and the files it had open for writing."""

    folder: Path

    def killed(self) -> Killed:
        journal = self.folder / JOURNAL_FILE
        return Killed(self.folder, read_chain(journal).lines, tuple(records_of(self.folder)))

    def cut_power(self, *, zeroed: bool) -> None:
        """Tear the last block of every file that was being written in its middle, or fill it with zeros."""
        for name in json.loads((self.folder.parents[1] / BEING_WRITTEN).read_text()):
            path = self.folder / name
            size = path.stat().st_size
            block = max(0, size - 1) // BLOCK_BYTES * BLOCK_BYTES
            with path.open("r+b") as file:
                if zeroed:
                    file.seek(block)
                    file.write(bytes(size - block))
                else:
                    file.truncate(block + (size - block) // 2)


def take_snapshots(
    commands: Commands,
    case: tuple[str, ...],
    folder: Path,
    wanted: Callable[[int], bool] = lambda _line: True,
) -> int:
    """Run a case with a snapshot at each wanted line of its journal in `folder`; the number of lines."""
    process = subprocess.Popen(
        [sys.executable, halted_program.__file__, *case, "--out", str(folder / "runs")],
        env=commands.environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    lines, world = 0, None
    while os.waitid(os.P_PID, process.pid, os.WSTOPPED | os.WEXITED | os.WNOWAIT).si_code == os.CLD_STOPPED:
        if wanted(lines):
            world = world or _world(commands)
            _keep(process.pid, folder, lines, world)
        lines += 1
        process.send_signal(signal.SIGCONT)
    _, messages = process.communicate()
    assert process.returncode == 0, messages
    assert commands.await_no_survivors() == []
    return lines


def snapshot_at(folder: Path, line: int, into: Path) -> Snapshot:
    """A copy of the snapshot at that line, which may be gone on with."""
    shutil.copytree(folder / f"{line:03d}", into, copy_function=_linked_or_copied, dirs_exist_ok=True)
    found = run_folder(into / "runs")
    assert found is not None
    return Snapshot(found)


def _keep(program: int, folder: Path, line: int, world: World) -> None:
    run = run_folder(folder / "runs")
    assert run is not None
    limit_s = time.monotonic() + REST_LIMIT_S
    while not world.arm().at_rest and time.monotonic() < limit_s:
        time.sleep(0.005)
    copy = folder / f"{line:03d}" / "runs" / run.name
    shutil.copytree(run, copy, copy_function=_linked_or_copied)
    save_world(world, copy / "theatre")
    (copy.parents[1] / BEING_WRITTEN).write_text(json.dumps(_open_for_writing(program, run)))


def _linked_or_copied(source: str, target: str) -> None:
    """The patient is written once, and read from then on."""
    if "/case/" in source or Path(source).is_socket():  # a kill leaves that of the live feed
        os.link(source, target)
    else:
        shutil.copy2(source, target)


def _open_for_writing(program: int, run: Path) -> list[str]:
    names = []
    for number in os.listdir(f"/proc/{program}/fd"):
        path = Path(os.readlink(f"/proc/{program}/fd/{number}"))
        flags = Path(f"/proc/{program}/fdinfo/{number}").read_text().split("flags:")[1].split()[0]
        if path.is_relative_to(run) and int(flags, 8) & os.O_ACCMODE and path.stat().st_size:
            names.append(path.relative_to(run).as_posix())
    return sorted(set(names))


def _world(commands: Commands) -> World:
    """The world of the theatre that runs: its devices were told where it is."""
    for number in commands.survivors():
        words = Path(f"/proc/{number}/cmdline").read_text().split("\0")
        if "--world" in words:
            return World.open(words[words.index("--world") + 1])
    raise AssertionError("no theatre runs")


MINI = ("run", "--sim", "--scene", "mini", "--seed", "3", "--json")
MINI_LINES = 169
FULL_LINES = (5, 50, 88, 106, 125, 162, 217, 278, 330, 374)  # of 404
FULL = ("run", "--sim", "--seed", "7", "--json")
# Kind of a line, and a word that the first such line has.
POWER_CUTS = (
    ("intent", "plan_check"),
    ("confirmation", "head_clamped"),
    ("work", "cart_push"),
    ("result", "global_localization"),
    ("intent", "relocalization:T1"),
    ("motion", "go"),
    ("motion", "settle"),
    ("result", "relocalization:T1"),
    ("confirmation", "registration:T1"),
    ("confirmation", "tool_change"),
    ("work", "gauge"),
    ("confirmation", "instrument_out"),
    ("motion", "insert"),
    ("instrument", "T1"),
    ("confirmation", "drill:T1"),
    ("work", "insert"),
    ("motion", "withdraw"),
    ("intent", "confirmation:T1"),
)


Case = tuple[Path, list[float]]  # snapshots of a case, and its target errors without a kill


def snapshots_of(factory: pytest.TempPathFactory, name: str, take: Callable[[Path], int]) -> tuple[Case, int]:
    folder, lines = made_once(factory, name, lambda folder: str(take(folder)))
    finished = run_folder(folder / "runs")
    assert finished is not None
    verified = in_this_process(ronna_sim, "verify", finished, "--json")
    errors_mm = [row["application_error_mm"] for row in json.loads(verified.stdout)["targets"]]
    return (folder, errors_mm), int(lines)


@pytest.fixture(scope="module")
def mini(tmp_path_factory: pytest.TempPathFactory) -> Case:
    case, lines = snapshots_of(tmp_path_factory, "mini", lambda to: take_snapshots(Commands(), MINI, to))
    assert lines == MINI_LINES, f"a case has {lines} lines now: MINI_LINES is of a former one"
    return case


@pytest.fixture(scope="module")
def full(tmp_path_factory: pytest.TempPathFactory) -> Case:
    case, lines = snapshots_of(
        tmp_path_factory, "full", lambda to: take_snapshots(Commands(), FULL, to, FULL_LINES.__contains__)
    )
    assert lines > max(FULL_LINES)
    return case


def line_of(folder: Path, entry: str, word: str) -> int:
    """The number of the first line of that kind with that word."""
    finished = run_folder(folder / "runs")
    assert finished is not None
    lines = enumerate(read_chain(finished / JOURNAL_FILE).lines)
    return next(number for number, line in lines if line["entry"] == entry and word in line.values())


def assert_same_targets(outcome: dict[str, Any], uninterrupted_mm: list[float]) -> None:
    errors_mm = [one["application_error_mm"] for one in outcome["targets"]]
    assert errors_mm == pytest.approx(uninterrupted_mm, abs=LARGEST_CHANGE_MM)


@pytest.mark.hazard(2)
@pytest.mark.parametrize("line", range(MINI_LINES))
def test_a_case_killed_at_any_journal_line_reaches_its_target(
    commands: Commands, mini: Case, tmp_path: Path, line: int
) -> None:
    folder, uninterrupted_mm = mini
    snapshot = snapshot_at(folder, line, tmp_path)
    assert_same_targets(reopen_run(commands, snapshot.killed()), uninterrupted_mm)
    replayed = in_this_process(ronna_procedure, "replay", snapshot.folder, "--json")
    assert replayed.returncode == 0, replayed.stdout


@pytest.mark.hazard(2)
@pytest.mark.parametrize("zeroed", [False, True], ids=["torn", "zeroed"])
@pytest.mark.parametrize("moment", POWER_CUTS, ids=" ".join)
def test_a_case_reaches_its_target_after_a_power_cut_tore_its_open_files(
    commands: Commands, mini: Case, tmp_path: Path, moment: tuple[str, str], zeroed: bool
) -> None:
    folder, uninterrupted_mm = mini
    snapshot = snapshot_at(folder, line_of(folder, *moment), tmp_path)
    snapshot.cut_power(zeroed=zeroed)
    assert_same_targets(reopen_run(commands, snapshot.killed()), uninterrupted_mm)


@pytest.mark.hazard(2)
@pytest.mark.parametrize("line", FULL_LINES)
def test_a_full_case_killed_at_any_of_ten_journal_lines_reaches_its_targets(
    commands: Commands, full: Case, tmp_path: Path, line: int
) -> None:
    folder, uninterrupted_mm = full
    assert_same_targets(reopen_run(commands, snapshot_at(folder, line, tmp_path).killed()), uninterrupted_mm)
