"""What hands have done through the guide at each trajectory: it stays done, whatever moves or ends since."""

from __future__ import annotations

from collections.abc import Mapping

from procedures.engine.journal import Entry, Journal
from ronna_hw.clock import Clock

Stages = dict[str, dict[str, bool]]  # trajectory -> task -> whether it was confirmed to be done


class WorkedStages:
    """The journal says that a stage begins before hands do anything, and that it is done once confirmed."""

    def __init__(self, journal: Journal, clock: Clock) -> None:
        self._journal = journal
        self._clock = clock
        self._known: Stages = {}

    def at(self, trajectory: str) -> Mapping[str, bool]:
        """The stages that were begun there, by their tasks, and whether each was confirmed to be done."""
        return dict(self._known.get(trajectory, {}))

    def begins(self, trajectory: str, task: str) -> None:
        """From here on it counts as begun."""
        self._note(trajectory, task, done=False)

    def is_done(self, trajectory: str, task: str) -> None:
        """Somebody confirmed it."""
        self._note(trajectory, task, done=True)

    def take_up(self, known: Stages) -> None:
        """Take for true what the journal of a run that is taken up again says."""
        self._known = {trajectory: dict(tasks) for trajectory, tasks in known.items()}

    def _note(self, trajectory: str, task: str, *, done: bool) -> None:
        self._journal.write(Entry.STAGE, self._clock.now_s(), trajectory=trajectory, task=task, done=done)
        self._known.setdefault(trajectory, {})[task] = done
