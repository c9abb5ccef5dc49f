"""Progress of a running or resumed case: which steps are done, left out and next."""

from __future__ import annotations

from procedures.engine.case import Case, StepKey, Stored
from procedures.engine.order import CaseOrder, Phase, StepSpec
from procedures.journal.results import StepResult
from ronna_hw.records import Record


class CaseProgress:
    """Case progress, derived from step order, results and the latest step."""

    def __init__(self, order: CaseOrder, case: Case, latest: StepKey | None = None) -> None:
        self.order = order
        self.case = case
        self.latest = latest

    def left_out(self, key: StepKey) -> str | None:
        """Return the reason why a step's trajectory was left out earlier, or None."""
        return self.order.exclusions_at(key, self.case.left_out).get(key.trajectory or "")

    def is_settled(self, key: StepKey) -> bool:
        """Whether a step needs no work: its result is valid, or its trajectory is left out or finished."""
        if self.case.stands(key) or self.left_out(key) is not None:
            return True
        return key.trajectory is not None and key.trajectory in self.case.trajectories_finished_before_move

    def remains(self, name: str) -> bool:
        """Whether a step of this name is still to be done."""
        return any(str(key) == name and not self.is_settled(key) for key in self.order.sequence)

    @property
    def _all_finished_before(self) -> bool:
        """Whether every target was finished before something moved, so no step leads to a target any more."""
        return self.case.trajectories_finished_before_move.issuperset(self.order.trajectories or ("",))

    @property
    def over(self) -> bool:
        """Whether no step remains. The arm may still be away from home."""
        return self._all_finished_before or all(map(self.is_settled, self.order.sequence))

    @property
    def continuation(self) -> StepKey | None:
        """The step that must directly follow the latest one, or None."""
        return self.order.continuation(self.latest)

    @property
    def upcoming(self) -> StepKey | None:
        """The next step, or None if no step remains.

        A step that must follow the latest comes first. A step that may only follow another, which was not the
        latest, comes after that one is done again.
        """
        if self.over:
            return None
        latest, only = self.latest, self.continuation
        if latest is not None and only is not None and self.case.stands(latest) and not self.is_settled(only):
            return only
        key = next(key for key in self.order.sequence if not self.is_settled(key))
        while self.order.spec(key).continues:
            before = self.order.before(key)[-1]
            if before == latest:
                break
            key = before
        return key

    def why_not_now(self, key: StepKey) -> tuple[str, ...]:
        """Return the reasons why a step may not run next; empty if it may."""
        if (reason := self.left_out(key)) is not None:
            return (f"{key.trajectory} was left out: {reason}",)
        if self._all_finished_before:
            return ("the work at every target is done: use home to end the case",)
        return self.order.unmet(key, self.latest, self.is_settled)

    def advice_now(self, key: StepKey) -> str | None:
        """Return advice if a different step must immediately follow the latest one, or None."""
        only = self.continuation
        if only is None or key == only or self.is_settled(only):
            return None
        between = f"Nothing may come between {self.latest} and {only}"
        if self.order.spec(only).moves:
            return f"{between}: run {only} first."
        # It starts from where the latest step ended: from home, other steps may follow.
        return f"{between}: run {only} first, or use home; then ask why {key} again."

    def why_not_up_to(self, key: StepKey) -> str:
        """Return why the case cannot be run up to a step; empty if it can."""
        if self.case.stands(key):
            return f"{key} is already done"
        if (reason := self.left_out(key)) is not None:
            return f"{key.trajectory} was left out: {reason}"
        return f"{key.trajectory} is finished" if self.is_settled(key) else ""

    def status(self, key: StepKey) -> str:
        """Return a step's status: `done`, `left out`, `finished` (target), `next`, `superseded` or empty."""
        if self.case.stands(key):
            return "done"
        if self.left_out(key) is not None:
            return "left out"
        if self.is_settled(key):
            return "finished"
        if key == self.upcoming:
            return "next"
        return "superseded" if self.case.was_superseded(key) else ""

    @property
    def finished(self) -> tuple[str, ...]:
        """Trajectories whose work at the target is done."""
        done = (key for key in self.order.sequence if self.order.spec(key).finishes and self.case.stands(key))
        return tuple(key.trajectory for key in done if key.trajectory is not None)

    @property
    def checks_in_doubt(self) -> dict[StepKey, str]:
        """Tool checks that must be repeated, each with the fault that cast doubt on it.

        Empty when the tool is led to no target any more.
        """
        gone = {*self.finished, *(one.trajectory for one in self.case.left_out)}
        if gone.issuperset(self.order.trajectories):
            return {}
        doubts = {key: self.case.doubt_at(key) for key in self.order.checks_of_tool}
        return {key: fault for key, fault in doubts.items() if fault is not None}

    def records_superseded_by(self, key: StepKey) -> tuple[Record, ...]:
        """Return the records that a step's new result would supersede, sparing other finished targets."""
        return self.case.records_superseded_by(key, self._other_lasting_trajectories(key))

    def accept(self, key: StepKey, stored: Stored[StepResult]) -> None:
        """Accept a new result in place of the results it supersedes."""
        self.case.accept(key, stored, self._other_lasting_trajectories(key))

    def records_voided_by(self, key: StepKey) -> tuple[Record, ...]:
        """Return the records voided together with a step's result, except those of finished targets."""
        return self.case.records_superseded_by(key, self._lasting_trajectories(key))

    def void(self, key: StepKey) -> None:
        """Void a step's result and its descendants, sparing finished targets."""
        self.case.void(key, self._lasting_trajectories(key))

    def _lasting_trajectories(self, key: StepKey) -> tuple[str, ...]:
        """Return the finished trajectories; only a new CT or plan invalidates their results."""
        return () if self.order.spec(key).phase is Phase.PREOPERATIVE else self.finished

    def _other_lasting_trajectories(self, key: StepKey) -> tuple[str, ...]:
        return tuple(name for name in self._lasting_trajectories(key) if name != key.trajectory)


def unusable_inputs(case: Case, spec: StepSpec[StepResult], key: StepKey) -> tuple[str, ...]:
    """Return the reasons why a step's inputs are unusable; empty if they are usable.

    Results of a trajectory that was finished before something moved are only shown; they guide no further
    motion.
    """
    found = {model: case.find(model, key.trajectory) for model in spec.reads}
    where = f" for {key.trajectory}" if key.trajectory else ""
    missing = tuple(f"no result of {model.kind}{where}" for model, one in found.items() if one is None)
    read = [one.record.identifier for one in found.values() if one is not None]
    past = [identifier for identifier in read if identifier in case.finished_before_move]
    return missing or ((f"made before something moved: {', '.join(past)}",) if past else ())
