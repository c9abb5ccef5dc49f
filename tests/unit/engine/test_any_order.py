"""Under any order of steps, repetitions and failures, nothing works or moves on an invalid result."""

import itertools
import tempfile
from contextlib import nullcontext
from dataclasses import replace
from enum import Enum, auto
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from plain_steps import plain_steps
from recording_cell import HOME, RecordingCell, RecordingOperator

from procedures.engine.case import Case, StepKey
from procedures.engine.context import StepContext
from procedures.engine.order import Outcome, Scope, StepSpec, order_of
from procedures.journal.errors import StepRefused
from procedures.journal.results import StepResult
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Topic
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LinkTimeout
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.records import Record


class Failure(Enum):
    """Where a step may come to its end early."""

    PRECONDITION = auto()
    BEFORE_READING = auto()
    AFTER_READING = auto()
    CONFIRMATION = auto()
    MOTION = auto()


failures = st.sampled_from([None] * 20 + list(Failure))
# How many of its results a step does not read, though it declares them.
unread_counts = st.sampled_from([0, 0, 0, 1, 2])


class AnyOrder(RuleBasedStateMachine):
    """An engine that is told to run any step at any time. The model beside it is as simple as can be."""

    localizes_per_trajectory = True

    def __init__(self) -> None:
        super().__init__()
        self._folder = tempfile.TemporaryDirectory(prefix="any-order-")
        self.cell = RecordingCell(Path(self._folder.name), operator=RecordingOperator(Topic.TOOL_CHECK))
        self.cell.arm.state = Lifecycle.ACTIVE
        self.cell.arm.blocked = self.meet_motion
        self.failure: Failure | None = None  # of the step that runs
        self.unread = 0
        self.numbers = itertools.count(1)  # one for each result: its `number`
        self.made_from: dict[int, tuple[StepKey, tuple[int, ...]]] = {}
        self.latest: dict[StepKey, int] = {}
        self.used: tuple[int, ...] = ()  # numbers of the results that the step that runs has read
        self.moved = 0
        self.read: dict[str, str] = {}  # identifiers and hashes that the step that runs has read
        self.inside: str | None = None  # the trajectory in which the instrument is
        works = {spec.name: self.work(spec) for spec in plain_steps()}
        steps = [replace(spec, preconditions=self.unmet) for spec in plain_steps(**works)]
        order = order_of(steps, ("T1", "T2"), localizes_per_trajectory=self.localizes_per_trajectory)
        self.engine = self.cell.engine(order)
        self.files: dict[str, bytes] = {}

    def work(self, spec: StepSpec[StepResult]):
        def run(context: StepContext) -> Outcome[StepResult]:
            if self.failure is Failure.BEFORE_READING:
                raise LinkTimeout("drawn")
            self.read, self.used = {}, ()
            # What continues another step reads it: otherwise it would outlast the repetition of that step.
            unread = min(self.unread, len(spec.reads) - spec.continues)
            for model in spec.reads[unread:]:
                self.used += (context.result(model).number,)
                stored = self.cell.case.find(model, context.key.trajectory)
                assert stored is not None
                self.read[stored.record.identifier] = stored.record.sha256
            if self.failure is Failure.AFTER_READING:
                raise LinkTimeout("drawn")
            if self.failure is Failure.CONFIRMATION:
                context.confirm(Topic.TOOL_CHECK, "the tool", "drawn")
            number = next(self.numbers)
            if spec.scope is Scope.TRAJECTORY:
                A1, *others = HOME
                context.workcell.master.go((A1 + 1e-4 * number, *others))
            self.made_from[number] = (context.key, self.used)
            return Outcome(spec.result(number=number))

        return run

    def meet_motion(self, _start: object, _target: object) -> bool:
        """The arm is about to move."""
        self.moved += 1
        superseded = [number for number in self.used if not self.valid(number)]
        assert superseded == [], f"the arm moves on superseded results: {superseded}"
        return False  # the way is clear

    def valid(self, number: int) -> bool:
        """Whether a result is its step's latest, and so is all that it was made from."""
        key, used = self.made_from[number]
        return self.latest.get(key) == number and all(map(self.valid, used))

    def unmet(self, _context: StepContext) -> tuple[str, ...]:
        return ("drawn",) if self.failure is Failure.PRECONDITION else ()

    def follow_instrument(self, key: StepKey) -> None:
        if self.inside is not None:
            assert key.trajectory == self.inside, f"{key} with the instrument in {self.inside}"
            assert key.name in ("held", "back")
        self.inside = {"approach": key.trajectory, "held": self.inside}.get(key.name)

    @rule(data=st.data(), failure=failures, unread=unread_counts)
    def run_any(self, data: st.DataObject, failure: Failure | None, unread: int) -> None:
        key = data.draw(st.sampled_from(self.engine.order.sequence))
        try:
            self.attempt(key, failure, unread)
        except StepRefused:
            assert self.engine.why_refused(key)

    @rule(failure=failures, unread=unread_counts)
    def run_next(self, failure: Failure | None, unread: int) -> None:
        if self.engine.upcoming is not None and not self.engine.machine.ended:
            refused = pytest.raises(StepRefused, match="drawn")
            with refused if failure is Failure.PRECONDITION else nullcontext():
                self.attempt(self.engine.upcoming, failure, unread)

    @rule(data=st.data())
    def void_any(self, data: st.DataObject) -> None:
        key = data.draw(st.sampled_from(self.engine.order.sequence))
        if self.inside is None and self.cell.case.stands(key):
            self.engine.void(key, LinkTimeout("something moved"))
            del self.latest[key]

    def attempt(self, key: StepKey, failure: Failure | None = None, unread: int = 0) -> None:
        self.failure, self.unread = failure, unread
        self.cell.arm.failing = LinkTimeout("drawn") if failure is Failure.MOTION else None
        standing = self.cell.case.valid_results
        ended = NotConfirmed if failure is Failure.CONFIRMATION else LinkTimeout
        try:
            record = self.engine.run_step(key)
        except ended:
            assert self.engine.machine.state == "held"
            assert self.cell.case.valid_results == standing
            return
        moves = self.engine.order.spec(key).scope is Scope.TRAJECTORY
        assert failure is None or (failure is Failure.MOTION and not moves)
        assert record.parents == self.read
        self.follow_instrument(key)
        self.latest[key] = max(self.made_from)

    @invariant()
    def no_file_is_ever_written_twice(self) -> None:
        for path in (self.cell.folder / "records").iterdir():
            assert self.files.setdefault(path.name, path.read_bytes()) == path.read_bytes()

    @invariant()
    def what_stands_descends_only_from_what_stands(self) -> None:
        standing = {stored.record.identifier for stored in self.cell.case.valid_results}
        for stored in self.cell.case.valid_results:
            assert set(stored.record.parents) <= standing

    @invariant()
    def the_journal_tells_the_same_as_the_engine(self) -> None:
        run = inspect_run(self.cell.folder).require_unchanged()
        said = {record.identifier for record in run.records} - run.superseded
        assert said == {stored.record.identifier for stored in self.cell.case.valid_results}

    def teardown(self) -> None:
        self.cell.journal.close()
        self._folder.cleanup()


def only_itself(case: Case, key: StepKey, _finished: object = ()) -> tuple[Record, ...]:
    """What a repeated step supersedes, if what descends from its former result were forgotten."""
    return tuple(
        stored.record for stored in case.valid_results if case.record_of(key) == stored.record.identifier
    )


@pytest.mark.parametrize("forgets", [False, True])
def test_a_case_that_forgets_to_supersede_what_descends_is_caught_by_a_motion(
    monkeypatch: pytest.MonkeyPatch, forgets: bool
) -> None:
    if forgets:
        monkeypatch.setattr(Case, "records_superseded_by", only_itself)
        monkeypatch.setattr(Case, "finished_before_move", frozenset())  # which would refuse the step
    drawn = AnyOrder()
    find = drawn.engine.order.find
    for name in (
        "image",
        "localization:T1",
        "fit:T1",
        "localization:T2",
        "fit:T2",
        "tool_on",
        "localization:T1",
    ):
        drawn.attempt(find(name))
    caught = pytest.raises(AssertionError, match=r"moves on superseded results: \[3\]")
    with caught if forgets else pytest.raises(StepRefused, match="fit:T1 comes first"):
        drawn.attempt(find("approach:T1"))
    assert drawn.moved == forgets
    drawn.attempt(find("fit:T1"))
    drawn.attempt(find("approach:T1"))
    assert drawn.moved == forgets + 1
    drawn.teardown()


class AnyOrderLocalizedOnce(AnyOrder):
    """A strategy that localizes once, for both trajectories."""

    localizes_per_trajectory = False


TestAnyOrder = AnyOrder.TestCase
TestAnyOrderLocalizedOnce = AnyOrderLocalizedOnce.TestCase
few = settings(max_examples=5, stateful_step_count=40, deadline=None)
TestAnyOrder.settings = TestAnyOrderLocalizedOnce.settings = few


@pytest.mark.slow
class TestManyOrders(AnyOrder.TestCase):
    settings = settings(few, max_examples=60)


@pytest.mark.slow
class TestManyOrdersLocalizedOnce(AnyOrderLocalizedOnce.TestCase):
    settings = settings(few, max_examples=20)
