"""What hands have done through the guide at each trajectory: it stays done, whatever moves or ends since."""

from __future__ import annotations

from collections.abc import Mapping

from procedures.journal.journal import Entry, Journal, JournalValue
from ronna_hw.clock import Clock

Stages = dict[str, dict[str, bool]]  # trajectory -> task -> whether it was confirmed to be done
Stop = Mapping[str, JournalValue]  # how a depth stop was set
Stops = dict[str, Stop]  # by trajectory


class WorkedStages:
    """The journal says that a stage begins before hands do anything, and that it is done once confirmed."""

    def __init__(self, journal: Journal, clock: Clock) -> None:
        self._journal = journal
        self._clock = clock
        self._known: Stages = {}
        self._stops: Stops = {}

    def at(self, trajectory: str) -> Mapping[str, bool]:
        """The stages that were begun there, by their tasks, and whether each was confirmed to be done."""
        return dict(self._known.get(trajectory, {}))

    def stop_at(self, trajectory: str) -> Stop | None:
        """How the depth stop was set there last; None where it was not."""
        return self._stops.get(trajectory)

    def stop_is_set(self, trajectory: str, stop: Stop) -> None:
        """The depth stop was set, read and confirmed."""
        self._write(trajectory=trajectory, stop=stop)
        self._stops[trajectory] = stop

    def begins(self, trajectory: str, task: str) -> None:
        """From here on it counts as begun."""
        self._note(trajectory, task, done=False)

    def is_done(self, trajectory: str, task: str) -> None:
        """Somebody confirmed it."""
        self._note(trajectory, task, done=True)

    def take_up(self, known: Stages, stops: Stops) -> None:
        """Restore the state recorded in the journal of a resumed run."""
        self._known = {trajectory: dict(tasks) for trajectory, tasks in known.items()}
        self._stops = dict(stops)

    def _note(self, trajectory: str, task: str, *, done: bool) -> None:
        self._write(trajectory=trajectory, task=task, done=done)
        self._known.setdefault(trajectory, {})[task] = done

    def _write(self, **data: JournalValue) -> None:
        self._journal.write(Entry.STAGE, self._clock.now_s(), **data)
