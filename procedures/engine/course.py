"""Which steps of a case are done, left out or next: the same while it runs and after a restart."""

from __future__ import annotations

from procedures.engine.case import Case, Stored
from procedures.engine.order import CaseOrder
from procedures.engine.step import Phase, StepKey
from procedures.journal.results import StepResult
from ronna_hw.records import Record


class Course:
    """The steps of a case, its results, and the step that was done last, unless something came between."""

    def __init__(self, order: CaseOrder, case: Case, latest: StepKey | None = None) -> None:
        self.order = order
        self.case = case
        self.latest = latest

    # What comes next

    def left_out(self, key: StepKey) -> str | None:
        """Why a step is not done because its trajectory was left out before it; None when it was not."""
        return self.order.left_out_at(key, self.case.left_out).get(key.trajectory or "")

    def settled(self, key: StepKey) -> bool:
        """Whether a step's result is valid, or its trajectory is left out, or was finished before a move."""
        if self.case.stands(key) or self.left_out(key) is not None:
            return True
        return key.trajectory is not None and key.trajectory in self.case.past_trajectories

    def remains(self, name: str) -> bool:
        """Whether a step of that name is still to be done."""
        return any(str(key) == name and not self.settled(key) for key in self.order.sequence)

    @property
    def _all_finished_before(self) -> bool:
        """Whether every target was finished before something moved: the steps would lead to none."""
        return self.case.past_trajectories.issuperset(self.order.trajectories or ("",))

    @property
    def over(self) -> bool:
        """Whether nothing remains to be done; the arm may still be where it was stopped."""
        return self._all_finished_before or all(map(self.settled, self.order.sequence))

    @property
    def continuation(self) -> StepKey | None:
        """The one step that may follow the latest, where nothing else may come between."""
        return self.order.continuation(self.latest)

    @property
    def upcoming(self) -> StepKey | None:
        """The step that comes next, or None when nothing remains.

        What must follow the latest step comes first. A step that may only follow another, which was not the
        latest, comes after that one is done again.
        """
        if self.over:
            return None
        latest, only = self.latest, self.continuation
        if latest is not None and only is not None and self.case.stands(latest) and not self.settled(only):
            return only
        key = next(key for key in self.order.sequence if not self.settled(key))
        while self.order.spec(key).continues:
            before = self.order.before(key)[-1]
            if before == latest:
                break
            key = before
        return key

    def why_not_now(self, key: StepKey) -> tuple[str, ...]:
        """Why it is not that step's turn; empty when it may be."""
        if (reason := self.left_out(key)) is not None:
            return (f"{key.trajectory} was left out: {reason}",)
        if self._all_finished_before:
            return ("the work at every target is done: use home to park the arm",)
        return self.order.unmet(key, self.latest, self.settled)

    def why_not_up_to(self, key: StepKey) -> str:
        """Why the case cannot be run up to a step; empty if it can."""
        if self.case.stands(key):
            return f"{key} is already done"
        if (reason := self.left_out(key)) is not None:
            return f"{key.trajectory} was left out: {reason}"
        return f"{key.trajectory} is finished" if self.settled(key) else ""

    def status(self, key: StepKey) -> str:
        """`done`, `left out`, `finished`: its target is; `next`, `superseded`, or nothing."""
        if self.case.stands(key):
            return "done"
        if self.left_out(key) is not None:
            return "left out"
        if self.settled(key):
            return "finished"
        if key == self.upcoming:
            return "next"
        return "superseded" if self.case.was_superseded(key) else ""

    # What stands

    @property
    def finished(self) -> tuple[str, ...]:
        """The trajectories at whose targets the work is done."""
        done = (key for key in self.order.sequence if self.order.spec(key).finishes and self.case.stands(key))
        return tuple(key.trajectory for key in done if key.trajectory is not None)

    @property
    def checks_in_doubt(self) -> dict[StepKey, str]:
        """The checks of the tool that must be repeated, and the fault that came after each.

        None when the tool is led to no target any more.
        """
        gone = {*self.finished, *(one.trajectory for one in self.case.left_out)}
        if gone.issuperset(self.order.trajectories):
            return {}
        doubts = {key: self.case.doubt_at(key) for key in self.order.checks_of_tool}
        return {key: fault for key, fault in doubts.items() if fault is not None}

    def superseded_by(self, key: StepKey) -> tuple[Record, ...]:
        """What a new result of that step supersedes: of the targets that are finished, only of its own."""
        return self.case.superseded_by(key, self._outlasting_again(key))

    def accept(self, key: StepKey, stored: Stored[StepResult]) -> None:
        """Accept a new result in place of what it supersedes."""
        self.case.accept(key, stored, self._outlasting_again(key))

    def voided_with(self, key: StepKey) -> tuple[Record, ...]:
        """What no longer holds when that step's result does not: nothing of the targets that are finished."""
        return self.case.superseded_by(key, self._outlasting(key))

    def void(self, key: StepKey) -> None:
        """Let neither that step's result stand nor what no longer holds with it."""
        self.case.void(key, self._outlasting(key))

    def _outlasting(self, key: StepKey) -> tuple[str, ...]:
        """Trajectories whose results stay: what moves later does not undo what was finished.

        Another CT or plan does.
        """
        return () if self.order.spec(key).phase is Phase.PREOPERATIVE else self.finished

    def _outlasting_again(self, key: StepKey) -> tuple[str, ...]:
        return tuple(name for name in self._outlasting(key) if name != key.trajectory)
