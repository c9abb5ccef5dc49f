"""An instrument in the guide: while it is in an entry or in the gauge, or may be, nothing moves at all."""

from __future__ import annotations

from dataclasses import replace

from procedures.journal.journal import Entry
from procedures.workcell.arm_log import ArmLog
from procedures.workcell.errors import InstrumentInGuide
from procedures.workcell.worked_stages import WorkedStages


class Instrument:
    """The journal records an insertion before it begins, and a removal once someone has confirmed it."""

    def __init__(self, log: ArmLog) -> None:
        self._log = log
        self.stages = WorkedStages(log)  # of the work with it

    @property
    def inside(self) -> str | None:
        """The trajectory, or the gauge, in which it is or may be; None while it is out."""
        return self._log.history.instrument_in

    def goes_in(self, trajectory: str) -> None:
        """From here on it counts as inside."""
        self._log.write(Entry.INSTRUMENT, trajectory=trajectory, inside=True)

    def is_out(self) -> None:
        """Someone confirmed that it is out."""
        if self.inside is not None:
            self._log.write(Entry.INSTRUMENT, trajectory=self.inside, inside=False)

    def assume_inside(self, trajectory: str) -> None:
        """It may be inside, although the journal does not say so."""
        self._log.history = replace(self._log.history, instrument_in=trajectory, instrument_out=False)

    def require_out(self, what: str) -> None:
        """Raises TOOL-001 while it is inside."""
        if self.inside is not None:
            raise InstrumentInGuide(
                f"{what}: an instrument is in the guide, and in {self.inside}",
                expected="the instrument removed, and confirmed to be out",
            )
