"""What a kill at each line of a journal leaves, from one case: halted at the line, its folder copied.

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

import halted_program
from kills import Killed
from run_folders import records_of, run_folder
from user_commands import Commands

from procedures.journal.journal import BLOCK_BYTES, JOURNAL_FILE
from ronna_hw.evidence.journal_reading import read_chain
from sim.world.saved_world import save_world
from sim.world.world import World

BEING_WRITTEN = "being_written.json"
REST_LIMIT_S = 0.3  # that the theatre gives an arm on its way


@dataclass(frozen=True)
class Snapshot:
    """What a program that was killed at a line had left, and which of its files it had open for writing."""

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
    if "/case/" in source:
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
