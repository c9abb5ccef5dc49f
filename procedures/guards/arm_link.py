"""The robot link: the arm's pose is fresh, and few of the last cycles were late or lost."""

from __future__ import annotations

from procedures.workcell import Workcell
from ronna_hw.devices.lifecycle import RUNNING
from ronna_hw.devices.readings import LinkStatistics, Validity

LARGEST_BAD_SHARE = 0.05  # of the cycles; the driver slows down at more than 3 in a row, far below this
LEAST_CYCLES = 250  # one second: fewer say little


class ArmLink:
    """What the arm's driver says of its link, from one checkpoint to the next."""

    name = "robot link"

    def __init__(self, workcell: Workcell) -> None:
        self._workcell = workcell
        self._since: LinkStatistics | None = None
        self._verdict: str | None = None

    def unmet(self) -> str | None:
        """That the pose is old, or how bad the link is."""
        seen = self._workcell.arm.observe()
        if seen.state not in RUNNING:  # a fault is told by whatever moves the arm
            self._since = self._verdict = None
            return None
        if seen.reading is not None and seen.reading.validity is Validity.STALE:
            return (
                "the arm has not reported its position for too long: check its network "
                "cable and the controller"
            )
        return self._quality()

    def _quality(self) -> str | None:
        now = self._workcell.link_statistics()
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
