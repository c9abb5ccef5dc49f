"""A case that runs as a command of its own: what its journal says, what is done to it, how it ends."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from math import radians
from pathlib import Path
from typing import Any

from run_folders import run_folder
from single_faults import STOPS, codes_told
from user_commands import Commands
from waiting import eventually

from procedures.journal.journal import JOURNAL_FILE, Entry, Line, read_journal
from ronna_hw.control_port import ask_control_port
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.inspection import inspect_run
from sim.world.descriptions import DESCRIPTIONS
from sim.world.running import find_running
from sim.world.world import World

ENDS_S = 600.0  # host time of a case, beside other work
WORLD = re.compile(r"shm:///proc/\d+/fd/\d+")


class RunningCase:
    """A case, and the processes that belong to it."""

    def __init__(self, commands: Commands, words: Sequence[str], out: Path) -> None:
        self._commands, self._out = commands, out
        self._lines: list[Line] = []
        self._read_bytes = 0
        self._world: World | None = None
        self.process = commands.start("ronna-procedure", "run", "--sim", "--json", *words, "--out", str(out))

    @property
    def folder(self) -> Path:
        folder = run_folder(self._out)
        assert folder is not None
        return folder

    @property
    def lines(self) -> list[Line]:
        """Its journal as far as it is written."""
        folder = run_folder(self._out)
        if folder is not None and (folder / JOURNAL_FILE).exists():
            with (folder / JOURNAL_FILE).open("rb") as journal:
                journal.seek(self._read_bytes)
                whole, end, _ = journal.read().rpartition(b"\n")
            self._lines += map(json.loads, whole.splitlines())
            self._read_bytes += len(whole + end)
        return self._lines

    @property
    def step(self) -> str:
        """The step that began last."""
        begun = (str(line["step"]) for line in reversed(self.lines) if line["entry"] == Entry.INTENT)
        return next(begun, "")

    def await_line(self, pick: Callable[[Line], bool]) -> Line:
        """Return the first line of its journal that is picked, as soon as that is there."""
        self.eventually(lambda: any(map(pick, self.lines)))
        return next(filter(pick, self._lines))

    def eventually(self, condition: Callable[[], bool]) -> None:
        """Return when the condition holds, or the case has ended."""
        eventually(lambda: self.process.poll() is not None or condition(), ENDS_S)

    def find(self, words: str) -> int | None:
        """The process whose command line has these words, the first of several."""
        found = [number for number in sorted(self._commands.survivors()) if words in _command_line(number)]
        return found[0] if found else None

    @property
    def world(self) -> World:
        """The true world of its theatre."""
        if self._world is None:
            found = [WORLD.search(_command_line(number)) for number in self._commands.survivors()]
            self._world = World.open(next(one[0] for one in found if one))
        return self._world

    def inject(self, fault: str) -> bool:
        """Tell its theatre of a fault, in a line as in a script; whether the theatre is there."""
        try:
            theatre = find_running(str(self.folder / "theatre"))
            ask_control_port(theatre.ready["endpoints"]["control"], "fault", line=fault)
        except RonnaError:
            return False
        return True

    def end(self) -> dict[str, Any]:
        """Return the outcome of a case that ends by itself: run whole, arm at rest, no process left."""
        told, said = self.process.communicate(timeout=ENDS_S)
        assert self._commands.await_no_survivors() == []
        assert told, said
        *_, last = read_journal(self.folder / JOURNAL_FILE)
        assert last["entry"] == Entry.CLOSED
        assert inspect_run(self.folder).problems == ()
        if self._world is not None:
            assert_rests_inside_ranges(self._world)
        outcome: dict[str, Any] = json.loads(told)
        return outcome

    @property
    def codes(self) -> set[str]:
        """The codes of its last stop."""
        return codes_told(next(line for line in reversed(self.lines) if line["entry"] in STOPS))

    def resume(self) -> None:
        """Begin it again where it has ended, in a theatre that goes on as that one was."""
        self._world = None
        words = ("resume", str(self.folder), "--accept", "--json")
        self.process = self._commands.start("ronna-procedure", *words)


def assert_rests_inside_ranges(world: World) -> None:
    """The arm rests inside its joint ranges, by the memory that the theatre shared."""
    arm = world.arm()
    assert arm.at_rest
    for joint, angle in zip(DESCRIPTIONS[world.scene.arm.variant].joints, arm.joints_rad, strict=True):
        assert radians(joint.lower_deg) <= angle <= radians(joint.upper_deg), joint.name


def _command_line(number: int) -> str:
    try:
        return Path(f"/proc/{number}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    except OSError:
        return ""
