"""Kills a case at what its journal says and has it taken up again."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any

from report_figures import figures_in, figures_of_records
from run_folders import records_of, run_folder
from user_commands import Commands
from waiting import eventually

from procedures.journal.journal import JOURNAL_FILE, Entry, Line, read_journal
from ronna_hw.devices.capabilities import Direction
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.recording.flight_recorder import BYTES_FOLDER, read_link
from ronna_hw.records import Record
from sim.world.scene.arm_design import KR6

MOTION_LINKS = ("robot.master.rsi", "robot.master.rtde")  # of either driver
MOVING_COMMANDS = {
    "robot.master.eki": re.compile(rb'Name="(RSI_START|DRIVES|PTP_AXIS|PTP_POS|LIN|SELECT)"'),
    "robot.master.dashboard": re.compile(rb"power on|brake release|play|unlock"),
    "robot.master.primary": re.compile(rb"def "),  # a program
}
REACHED_S = 100.0
# A localization and a positioning that are repeated differ by two such errors in three axes: four sigma.
LARGEST_CHANGE_MM = 4 * KR6.errors.repeatability_mm * 6**0.5


@dataclass(frozen=True)
class Killed:
    """What a killed run had left when it was gone."""

    folder: Path
    journal: tuple[Line, ...]
    records: tuple[Record, ...]


def killed_at(
    commands: Commands, case: tuple[str, ...], out: Path, says: str, program: str = "ronna-procedure"
) -> Killed:
    """Start a case and kill it as soon as its journal says that, or with "" when its folder is there.

    Nothing of it lives then.
    """
    process = commands.start(program, *case, "--out", str(out))

    def reached() -> bool:
        folder = run_folder(out)
        if folder is None or folder.name.startswith("."):
            return False
        journal = folder / JOURNAL_FILE
        return says.encode() in (journal.read_bytes() if journal.exists() else b"")

    eventually(lambda: process.poll() is not None or reached(), REACHED_S)
    process.kill()
    process.communicate()
    assert commands.await_no_survivors() == []
    folder = run_folder(out)
    assert folder is not None
    written = (folder / JOURNAL_FILE).exists()
    journal = tuple(read_journal(folder / JOURNAL_FILE)) if written else ()
    return Killed(folder, journal, tuple(records_of(folder)))


def reopen_run(commands: Commands, killed: Killed) -> dict[str, Any]:
    """What `resume` printed; nothing lives after it, nothing that was recorded is lost, the run is whole."""
    done = commands.run("ronna-procedure", "resume", str(killed.folder), "--accept", "--json")
    assert done.returncode == 0, done.stderr
    assert commands.await_no_survivors() == []
    lines = tuple(read_journal(killed.folder / JOURNAL_FILE))
    assert lines[: len(killed.journal)] == killed.journal
    now = {record.identifier: record for record in records_of(killed.folder)}
    assert all(now[record.identifier] == record for record in killed.records)
    assert_no_motion_before_acceptance(lines)
    assert_no_byte_before_acceptance(killed.folder, lines)
    assert inspect_run(killed.folder).problems == ()
    assert figures_in(killed.folder / "report.html") == figures_of_records(killed.folder)
    printed: dict[str, Any] = json.loads(done.stdout)
    return printed


def assert_no_byte_before_acceptance(folder: Path, lines: tuple[Line, ...]) -> None:
    """Between a restart and its acceptance nothing passed on the link over which the arm is moved.

    The controller got no command that moves it, or lets it be moved.
    """
    restarts = [line for line in lines if line["entry"] == Entry.RESTARTED]
    accepted = [line for line in lines if line["entry"] == Entry.ACCEPTED]
    if not restarts:
        return
    number = lines.index(restarts[-1])
    if not any(line["entry"] in (Entry.RESULT, Entry.MOTION) for line in lines[:number]):
        return  # it was begun anew: there was nothing to accept
    began = datetime.fromisoformat(str(restarts[-1]["host_time"]))
    ended = datetime.fromisoformat(str(accepted[-1]["host_time"])) if accepted else None
    bytes_folder = folder / BYTES_FOLDER
    since = [one for link in MOTION_LINKS for one in read_link(bytes_folder, link) if one.host_time > began]
    for passed in since:
        assert ended is not None, passed
        assert passed.host_time >= ended, passed
    for link, moving in MOVING_COMMANDS.items():
        for passed in read_link(bytes_folder, link):
            before = began < passed.host_time and (ended is None or passed.host_time < ended)
            if before and passed.direction is Direction.SENT:
                assert not (named := moving.search(passed.data)), named
    moved = any(line["entry"] == Entry.MOTION for line in lines[number:])
    assert since or not moved, "nothing of the arm's link was recorded, and the arm has moved"


def assert_no_motion_before_acceptance(lines: tuple[Line, ...]) -> None:
    """After every restart that had anything to accept, the acceptance comes before the first motion."""
    kinds = [line["entry"] for line in lines]
    for number, kind in enumerate(kinds):
        if kind == Entry.RESTARTED and Entry.MOTION in kinds[number:]:
            moved = kinds.index(Entry.MOTION, number)
            assert Entry.ACCEPTED in kinds[number:moved] or Entry.RESULT not in kinds[:number]
