"""Under any order of steps, repetitions and failures, nothing works or moves on an invalid result."""

import itertools
import tempfile
from contextlib import nullcontext
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from plain_steps import plain_order, plain_steps
from recording_cell import HOME, RecordingCell

from procedures.engine.case import Case
from procedures.engine.context import StepContext
from procedures.engine.run_folder import read_run
from procedures.engine.step import Outcome, Scope, StepKey, StepSpec
from procedures.results.errors import StepRefused
from procedures.results.result import StepResult
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LinkTimeout
from ronna_hw.records import Record

NAMES = [str(key) for key in plain_order().sequence]


class AnyOrder(RuleBasedStateMachine):
    """An engine that is told to run any step at any time. The model beside it is as simple as can be."""

    def __init__(self) -> None:
        super().__init__()
        self._folder = tempfile.TemporaryDirectory(prefix="any-order-")
        self.cell = RecordingCell(Path(self._folder.name))
        self.cell.arm.state = Lifecycle.ACTIVE
        self.cell.arm.blocked = self.meet_motion
        self.fail_next = False
        self.numbers = itertools.count(1)  # one for each result: its `number`
        self.made_from: dict[int, tuple[StepKey, tuple[int, ...]]] = {}
        self.latest: dict[StepKey, int] = {}
        self.used: tuple[int, ...] = ()  # numbers of the results that the step that runs has read
        self.moved = 0
        self.read: dict[str, str] = {}  # identifiers and hashes that the step that runs has read
        self.inside: str | None = None  # the trajectory in which the instrument is
        works = {spec.name: self.work(spec) for spec in plain_steps()}
        self.engine = self.cell.engine(plain_order(**works))
        self.files: dict[str, bytes] = {}

    def work(self, spec: StepSpec[StepResult]):
        def run(context: StepContext) -> Outcome[StepResult]:
            if self.fail_next:
                raise LinkTimeout("drawn")
            self.read, self.used = {}, ()
            for model in spec.reads:
                self.used += (context.result(model).number,)
                stored = self.cell.case.find(model, context.key.trajectory)
                assert stored is not None
                self.read[stored.record.identifier] = stored.record.sha256
            if spec.scope is Scope.TRAJECTORY:
                A1, *others = HOME
                context.workcell.go((A1 + 1e-4 * self.used[0], *others))
            self.follow_instrument(context.key)
            number = next(self.numbers)
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

    def follow_instrument(self, key: StepKey) -> None:
        if self.inside is not None:
            assert key.trajectory == self.inside, f"{key} with the instrument in {self.inside}"
            assert key.name in ("held", "back")
        self.inside = {"approach": key.trajectory, "held": self.inside}.get(key.name)

    @rule(name=st.sampled_from(NAMES), fails=st.integers(0, 40).map(lambda drawn: drawn == 0))
    def run_any(self, name: str, fails: bool) -> None:
        self.attempt(self.engine.order.find(name), fails)

    @rule()
    def run_next(self) -> None:
        if self.engine.upcoming is not None:
            self.attempt(self.engine.upcoming, False)

    @rule(name=st.sampled_from(NAMES))
    def void_any(self, name: str) -> None:
        key = self.engine.order.find(name)
        if self.inside is None and self.cell.case.stands(key):
            self.engine.void(key, LinkTimeout("something moved"))
            del self.latest[key]

    def attempt(self, key: StepKey, fails: bool) -> None:
        self.fail_next = fails
        try:
            record = self.engine.run_step(key)
        except StepRefused:
            return
        except LinkTimeout:
            assert self.engine.machine.state == "held"
            return
        assert record.parents == self.read
        self.latest[key] = max(self.made_from)

    @invariant()
    def no_file_is_ever_written_twice(self) -> None:
        for path in (self.cell.folder / "records").iterdir():
            assert self.files.setdefault(path.name, path.read_bytes()) == path.read_bytes()

    @invariant()
    def what_stands_descends_only_from_what_stands(self) -> None:
        standing = {stored.record.identifier for stored in self.cell.case.standing}
        for stored in self.cell.case.standing:
            assert set(stored.record.parents) <= standing

    @invariant()
    def the_journal_tells_the_same_as_the_engine(self) -> None:
        run = read_run(self.cell.folder)
        said = {record.identifier for record in run.records} - run.superseded
        assert said == {stored.record.identifier for stored in self.cell.case.standing}

    def teardown(self) -> None:
        self.cell.journal.close()
        self._folder.cleanup()


def only_itself(case: Case, key: StepKey, _finished: object = ()) -> tuple[Record, ...]:
    """What a repeated step supersedes, if what descends from its former result were forgotten."""
    return tuple(stored.record for stored in case.standing if case.record_of(key) == stored.record.identifier)


@pytest.mark.parametrize("forgets", [False, True])
def test_a_case_that_forgets_to_supersede_what_descends_is_caught_by_a_motion(
    monkeypatch: pytest.MonkeyPatch, forgets: bool
) -> None:
    if forgets:
        monkeypatch.setattr(Case, "superseded_by", only_itself)
        monkeypatch.setattr(Case, "past", frozenset())  # which would refuse the step
    drawn = AnyOrder()
    for name in (
        "image",
        "localization:T1",
        "fit:T1",
        "localization:T2",
        "fit:T2",
        "tool_on",
        "localization:T1",
    ):
        drawn.run_any(name, False)
    caught = pytest.raises(AssertionError, match=r"moves on superseded results: \[3\]")
    with caught if forgets else nullcontext():
        drawn.run_any("approach:T1", False)
    assert drawn.moved == forgets
    drawn.run_any("fit:T1", False)
    drawn.run_any("approach:T1", False)
    assert drawn.moved == forgets + 1
    drawn.teardown()


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=10, stateful_step_count=40, deadline=None)


@pytest.mark.slow
class TestManyOrders(AnyOrder.TestCase):
    settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
