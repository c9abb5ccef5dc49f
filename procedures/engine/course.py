"""What of a case is done, left out, or comes next: the same while it runs and after a restart."""

from __future__ import annotations

from dataclasses import dataclass

from procedures.engine.case import Case
from procedures.engine.order import CaseOrder
from procedures.engine.step import StepKey
from ronna_hw.records import Record


@dataclass(frozen=True)
class Course:
    """The steps of a case and its results."""

    order: CaseOrder
    case: Case

    def left_out(self, key: StepKey) -> str | None:
        """Why a step is not done because its trajectory was left out before it; None when it was not."""
        return self.order.left_out_at(key, self.case.left_out).get(key.trajectory or "")

    def settled(self, key: StepKey) -> bool:
        """Whether a step's result stands, or its trajectory is left out, or was finished before a move."""
        if self.case.stands(key) or self.left_out(key) is not None:
            return True
        return key.trajectory is not None and key.trajectory in self.case.past_trajectories

    @property
    def all_finished_before(self) -> bool:
        """Whether every target was finished before something moved: the steps would lead to none."""
        return self.case.past_trajectories.issuperset(self.order.trajectories or ("",))

    @property
    def over(self) -> bool:
        """Whether nothing remains to be done; the arm may still stand where it was stopped."""
        return self.all_finished_before or all(map(self.settled, self.order.sequence))

    def upcoming(self, latest: StepKey | None) -> StepKey | None:
        """The step that comes next after `latest`, or None when nothing remains.

        What must follow `latest` comes first. A step that may only follow another, which was not the last
        one, comes after that one is done again.
        """
        if self.over:
            return None
        only = self.order.continuation(latest)
        if latest is not None and only is not None and self.case.stands(latest) and not self.settled(only):
            return only
        key = next(key for key in self.order.sequence if not self.settled(key))
        while self.order.spec(key).continues:
            before = self.order.before(key)[-1]
            if before == latest:
                break
            key = before
        return key

    def status(self, key: StepKey, latest: StepKey | None) -> str:
        """`done`, `left out`, `finished`: its target is; `next`, `superseded`, or nothing."""
        if self.case.stands(key):
            return "done"
        if self.left_out(key) is not None:
            return "left out"
        if self.settled(key):
            return "finished"
        if key == self.upcoming(latest):
            return "next"
        return "superseded" if self.case.was_superseded(key) else ""

    def superseded_by(self, key: StepKey) -> tuple[Record, ...]:
        """What a new result of that step supersedes: of the targets that are finished, only of its own."""
        return self.case.superseded_by(key, self.order.outlasting_again(key, self.case.stands))
