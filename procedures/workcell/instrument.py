"""An instrument in the guide: while it is in an entry or in the gauge, or may be, nothing moves at all."""

from __future__ import annotations

from collections.abc import Mapping

from procedures.journal.journal import Entry
from procedures.workcell.arm_history import Stop
from procedures.workcell.arm_log import ArmLog
from procedures.workcell.errors import InstrumentInGuide


class WorkedStages:
    """Stages done through the guide at each trajectory. They stay done after motions, failures and restarts.

    The journal says that a stage begins before hands do anything, and that it is done once confirmed.
    """

    def __init__(self, log: ArmLog) -> None:
        self._log = log

    def at(self, trajectory: str) -> Mapping[str, bool]:
        """The stages that were begun there, by their tasks, and whether each was confirmed to be done."""
        return self._log.history.stages.get(trajectory, {})

    def stop_at(self, trajectory: str) -> Stop | None:
        """How the depth stop was set there last; None where it was not."""
        return self._log.history.stops.get(trajectory)

    def stop_is_set(self, trajectory: str, stop: Stop) -> None:
        """The depth stop was set, read and confirmed."""
        self._log.write(Entry.STAGE, trajectory=trajectory, stop=stop)

    def begins(self, trajectory: str, task: str) -> None:
        """From here on it counts as begun."""
        self._log.write(Entry.STAGE, trajectory=trajectory, task=task, done=False)

    def is_done(self, trajectory: str, task: str) -> None:
        """Someone confirmed it."""
        self._log.write(Entry.STAGE, trajectory=trajectory, task=task, done=True)


class Instrument:
    """The journal records an insertion before it begins, and a removal once someone has confirmed it."""

    def __init__(self, log: ArmLog) -> None:
        self._log = log
        self.stages = WorkedStages(log)  # of the work with it

    @property
    def inside(self) -> str | None:
        """The trajectory, or the gauge, in which it is or may be; None while it is out."""
        return self._log.history.place.instrument_may_be_inside

    def goes_in(self, trajectory: str) -> None:
        """From here on it counts as inside."""
        self._log.write(Entry.INSTRUMENT, trajectory=trajectory, inside=True)

    def is_out(self) -> None:
        """Someone confirmed that it is out."""
        if self.inside is not None:
            self._log.write(Entry.INSTRUMENT, trajectory=self.inside, inside=False)

    def assume_inside(self, trajectory: str) -> None:
        """It may be inside, although no line before says so."""
        self._log.write(Entry.INSTRUMENT, trajectory=trajectory, inside=True, assumed=True)

    def require_out(self, what: str) -> None:
        """Raises TOOL-001 while it is inside."""
        if self.inside is not None:
            raise InstrumentInGuide(
                f"{what}: an instrument is in the guide, and in {self.inside}",
                expected="the instrument removed, and confirmed to be out",
            )
