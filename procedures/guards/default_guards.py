"""Guards used in every procedure: disk, clock, robot link, mounted tool, records."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from procedures.engine.engine import Engine
from procedures.engine.events import Advisory
from procedures.guards.motion_watch import MotionWatch
from procedures.guards.tracker_guards import LineOfSight
from procedures.journal.free_space import LEAST_FREE_BYTES, describe_shortage
from procedures.operator.checkpoint import Guard
from procedures.workcell import Workcell
from procedures.workcell.supervised_arm import SupervisedArm
from ronna_hw.config import TheatreFile, read_theatre_file
from ronna_hw.devices.lifecycle import RUNNING
from ronna_hw.devices.readings import LinkStatistics, Validity
from ronna_hw.errors import RonnaError
from ronna_hw.roles import MASTER

LARGEST_BAD_SHARE = 0.05  # of the cycles; the driver slows down at more than 3 in a row, far below this
LEAST_CYCLES = 250  # one second: fewer mean little
LARGEST_STEP_S = 1.0  # a clock that is slewed stays below that between two checkpoints
Void = Callable[[RonnaError], None]
Stamp = tuple[int, int, int]  # inode, bytes, time of the last change


def case_guards(
    workcell: Workcell, folder: Path, find: Callable[[str], None], doubt_tool: Callable[[str], None]
) -> tuple[Guard, ...]:
    """Build the guards that are active from the first step to the last.

    `find` records a finding for the operator; `doubt_tool` is told when another tool is reported than the
    checked one.
    """
    return (
        DiskSpace(folder),
        WallClock(find),
        *map(ArmLink, workcell.arms.values()),
        ToolStillMounted(workcell, doubt_tool),
        LineOfSight(workcell.tracker, workcell.calibrations.tracker_frame.tool, workcell.clock.now_s),
    )


def patient_watch(engine: Engine, void: Void) -> MotionWatch:
    """Build the patient watch for motions. `void` invalidates results after a head movement."""
    setting = engine.setting
    return MotionWatch(
        setting.workcell,
        setting.memory,
        setting.settings.watch_patient,
        find=engine.find,
        tell=lambda text: engine.events.publish(Advisory(text=text)),
        void=void,
        beside=engine.checkpoint.beside,
    )


@dataclass
class ArmLink:
    """Guard for the link of one arm: a fresh arm pose, and few late or lost cycles since the last check."""

    monitored: SupervisedArm
    _since: LinkStatistics | None = None
    _verdict: str | None = None

    @property
    def name(self) -> str:
        whose = "" if self.monitored.role == MASTER else f" of the {self.monitored.name}"
        return f"robot link{whose}"

    def unmet(self) -> str | None:
        """Describe a stale pose or a bad link."""
        seen = self.monitored.arm.observe()
        if seen.state not in RUNNING:  # motions report a fault themselves
            self._since = self._verdict = None
            return None
        if seen.reading is not None and seen.reading.validity is Validity.STALE:
            return (
                "the arm has not reported its position for too long: check its network "
                "cable and the controller"
            )
        return self._quality()

    def _quality(self) -> str | None:
        now = self.monitored.link_statistics()
        since = self._since
        if since is None or now.cycles < since.cycles:
            self._since = now
            return None
        cycles = now.cycles - since.cycles
        if cycles < LEAST_CYCLES:
            return self._verdict
        bad = now.late_cycles + now.lost_cycles - since.late_cycles - since.lost_cycles
        self._since, self._verdict = now, None
        if bad > LARGEST_BAD_SHARE * cycles:
            self._verdict = (
                f"{bad} of the last {cycles} cycles were late or lost, more than "
                f"{LARGEST_BAD_SHARE:.0%}: close other programs on this computer, check cable and switch"
            )
        return self._verdict


@dataclass
class DiskSpace:
    """Guard for free disk space. Suspends the case before the journal can no longer be written."""

    folder: Path
    least_bytes: int = LEAST_FREE_BYTES
    name: str = "disk space"

    def unmet(self) -> str | None:
        return describe_shortage(self.folder, self.least_bytes)


@dataclass
class ToolStillMounted:
    """Guard for the mounted tool, as reported by the controller while the arm is streaming.

    `doubt_tool` is told when another tool is reported, and may end the step.
    """

    workcell: Workcell
    doubt_tool: Callable[[str], None]
    name: str = "mounted tool"

    def unmet(self) -> str | None:
        """Describe a mismatch between the reported tool and the checked one."""
        workcell = self.workcell
        expected = workcell.master.mount.checked_number
        if expected is None or workcell.master.arm.observe().state not in RUNNING:
            return None
        try:
            mounted = workcell.master.read_tool_number()
        except RonnaError:
            return None  # motions report the same themselves
        if mounted == expected:
            return None
        reported = f"tool {mounted}" if mounted else "no tool"
        found = f"the controller reports {reported} instead of the {workcell.master.tool}"
        self.doubt_tool(found)
        return f"{found}: mount the {workcell.master.tool} again"


class WallClock:
    """Guard that detects steps of the host's wall clock, which dates the records.

    No limit depends on the wall clock, so a jump stops nothing: it is a finding.
    """

    name = "clock"

    def __init__(
        self,
        find: Callable[[str], None],
        wall_s: Callable[[], float] = time.time,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._find = find
        self._wall_s, self._monotonic_s = wall_s, monotonic_s
        self._ahead_s = wall_s() - monotonic_s()

    def unmet(self) -> None:
        """Record a clock step as a finding. Never suspends the case."""
        ahead_s = self._wall_s() - self._monotonic_s()
        step_s = ahead_s - self._ahead_s
        if abs(step_s) > LARGEST_STEP_S:
            self._ahead_s = ahead_s
            self._find(
                f"the host's clock was changed by {step_s:+.1f} s: dates before and after do not agree; "
                "durations and limits are not affected"
            )


class UnchangedRecords:
    """Guard that checks the calibration and tool records in use against the theatre file.

    A file that nobody touched is not read again; a touched one is compared by content. The way out is not
    held up: it uses the records that brought the arm there.
    """

    name = "calibration and tool records"

    def __init__(self, path: Path, began_with: TheatreFile, in_use: Callable[[], bool]) -> None:
        """Set up the guard. `in_use` returns whether a step uses the records, other than to leave or home."""
        self._path = path
        self._records = _records(began_with)
        self._in_use = in_use
        self._seen: Stamp | None = None  # at the last comparison without difference

    def unmet(self) -> str | None:
        """List the changed records, or describe why the file cannot be read."""
        if not self._in_use():
            return None
        try:
            seen = self._path.stat()
            stamp = (seen.st_ino, seen.st_size, seen.st_mtime_ns)
            if stamp == self._seen:
                return None
            now = _records(read_theatre_file(self._path))
        except (RonnaError, OSError) as problem:
            return f"{self._path.name} cannot be read: restore it ({problem})"
        names = sorted(name for name in {*self._records, *now} if self._records.get(name) != now.get(name))
        if names:
            return (
                f"{', '.join(names)} in {self._path.name} changed after the case began with it: put the "
                "former file back, or leave, go home and start a new run"
            )
        self._seen = stamp
        return None


def _records(file: TheatreFile) -> dict[str, object]:
    calibrations = {} if file.calibration is None else file.calibration.records
    return {
        **{f"calibration.{name}": record for name, record in calibrations.items()},
        **{f"tools.{name}": record for name, record in file.tools.items()},
    }
