"""Every motion in the journal: its intent on disk before it begins, its result when the arm rests."""

from __future__ import annotations

from collections.abc import Callable

from procedures.engine.journal import Entry, Journal, JournalValue
from ronna_hw.clock import Clock
from ronna_hw.devices.readings import ArmReading
from ronna_hw.errors import RonnaError


class MotionLog:
    """Numbers the motions of a run and writes them down."""

    def __init__(self, journal: Journal, clock: Clock) -> None:
        self._journal = journal
        self._clock = clock
        self._count = 0

    def count_from(self, count: int) -> None:
        """Number the motions of a resumed run after those that it made before."""
        self._count = count

    def record(
        self,
        what: str,
        to: list[float],
        move: Callable[[], ArmReading],
        trajectory: str | None = None,
        **more: JournalValue,
    ) -> ArmReading:
        """Carry out a motion, to joints in rad or a position in mm, and write it down; its last reading.

        Raises PRO-003 before anything moves when the intent cannot be written, and what the motion raises.
        """
        self._count += 1
        number = self._count
        self._journal.write(
            Entry.MOTION, self._clock.now_s(), number=number, what=what, to=to, trajectory=trajectory, **more
        )
        try:
            reached = move()
        except BaseException as error:  # also an interruption: every intent has its result
            code = error.code if isinstance(error, RonnaError) else type(error).__name__
            self._journal.note(Entry.MOVED, self._clock.now_s(), number=number, error=code)
            raise
        self._journal.note(
            Entry.MOVED, self._clock.now_s(), number=number, joints_rad=list(reached.joints_rad)
        )
        return reached
