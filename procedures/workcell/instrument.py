"""An instrument in the guide: while it is in an entry or in the gauge, or may be, nothing moves at all."""

from __future__ import annotations

from procedures.journal.journal import Entry, Journal
from procedures.workcell.errors import InstrumentInGuide
from procedures.workcell.worked_stages import WorkedStages
from ronna_hw.clock import Clock


class Instrument:
    """The journal records an insertion before it begins, and a removal once someone has confirmed it."""

    def __init__(self, journal: Journal, clock: Clock) -> None:
        self._journal = journal
        self._clock = clock
        self._inside: str | None = None
        self.stages = WorkedStages(journal, clock)  # of the work with it

    @property
    def inside(self) -> str | None:
        """The trajectory, or the gauge, in which it is or may be; None while it is out."""
        return self._inside

    def goes_in(self, trajectory: str) -> None:
        """From here on it counts as inside."""
        self._journal.write(Entry.INSTRUMENT, self._clock.now_s(), trajectory=trajectory, inside=True)
        self._inside = trajectory

    def is_out(self) -> None:
        """Somebody confirmed that it is out."""
        if self._inside is not None:
            self._journal.write(Entry.INSTRUMENT, self._clock.now_s(), trajectory=self._inside, inside=False)
            self._inside = None

    def take_up(self, trajectory: str | None) -> None:
        """Restore the state in which a resumed run left it."""
        self._inside = trajectory

    def require_out(self, what: str) -> None:
        """Raises TOOL-001 while it is inside."""
        if self._inside is not None:
            raise InstrumentInGuide(
                f"{what}: an instrument is in the guide, and in {self._inside}",
                expected="the instrument removed, and confirmed to be out",
            )
