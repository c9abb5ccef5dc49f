"""What the arm and the hands at it do goes into the journal first, and counts from then on."""

from __future__ import annotations

from procedures.journal.journal import Entry, Journal, JournalValue
from procedures.workcell.arm_history import ArmHistory
from ronna_hw.clock import Clock


class ArmLog:
    """Writes the lines, and keeps the history that they add up to."""

    def __init__(self, journal: Journal, clock: Clock, history: ArmHistory) -> None:
        """`history` is the arm's, folded from the lines that the journal has already."""
        self._journal = journal
        self._clock = clock
        self.history = history

    def write(self, entry: Entry, **data: JournalValue) -> None:
        """For what is about to happen: on disk when this returns. Raises PRO-003."""
        self._journal.write(entry, self._clock.now_s(), arm=self.history.arm, **data)
        self.history = self.history.after({"entry": entry, "arm": self.history.arm, **data})

    def note(self, entry: Entry, **data: JournalValue) -> None:
        """For what has happened. Raises PRO-003."""
        self._journal.note(entry, self._clock.now_s(), arm=self.history.arm, **data)
        self.history = self.history.after({"entry": entry, "arm": self.history.arm, **data})
