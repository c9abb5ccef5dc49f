"""Twenty terminals follow a case in real time, and one of them hangs: the arm's link is unaffected."""

import json
import signal
from pathlib import Path

import pytest
from run_folders import REACHED_S, records_of, run_folder
from user_commands import Commands
from waiting import eventually

from procedures.engine.events.event_file import EVENTS_FILE

pytestmark = [pytest.mark.soak, pytest.mark.timeout(900)]

CASE = ("run", "--sim", "--scene", "mini", "--seed", "3", "--speed", "1", "--json")
CASE_LIMIT_S = 300.0
WATCHERS = 20
LATE_ANYWAY = 3  # of some three thousand cycles, on a computer that has other work as well


def begun(out: Path) -> Path:
    """The run's folder, once there is something to follow."""
    eventually(lambda: (folder := run_folder(out)) is not None and (folder / EVENTS_FILE).exists(), REACHED_S)
    folder = run_folder(out)
    assert folder is not None
    return folder


def late_cycles(commands: Commands, out: Path, watchers: int) -> int:
    """With the guide on the arm, of a case that so many watch, the first of whom is halted.

    Before that the watchers start: twenty interpreters at once are no business of the one who is watched.
    """
    case = commands.start("ronna-procedure", *CASE, "--out", str(out))
    folder = begun(out)
    watching = [commands.start("ronna-procedure", "watch", str(folder), "--json") for _ in range(watchers)]
    for one in watching[:1]:
        one.send_signal(signal.SIGSTOP)
    _, messages = case.communicate(timeout=CASE_LIMIT_S)
    assert case.returncode == 0, messages
    for one in watching[:1]:
        one.send_signal(signal.SIGCONT)
    for one in watching:
        seen, _ = one.communicate(timeout=CASE_LIMIT_S)
        assert json.loads(seen.splitlines()[-1])["what"]
    (link,) = (record.payload["link"] for record in records_of(folder) if record.kind == "retreat")
    assert isinstance(link, dict)
    return int(link["late_cycles"]) + int(link["lost_cycles"])


def test_twenty_watchers_one_of_them_halted_make_no_cycle_late(commands: Commands, tmp_path: Path) -> None:
    alone = late_cycles(commands, tmp_path / "alone", 0)
    assert late_cycles(commands, tmp_path / "watched", WATCHERS) <= alone + LATE_ANYWAY
