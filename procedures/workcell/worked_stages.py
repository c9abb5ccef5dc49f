"""Stages done through the guide at each trajectory. They stay done after motions, failures and restarts."""

from __future__ import annotations

from collections.abc import Mapping

from procedures.journal.journal import Entry
from procedures.workcell.arm_history import Stop
from procedures.workcell.arm_log import ArmLog


class WorkedStages:
    """The journal says that a stage begins before hands do anything, and that it is done once confirmed."""

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
