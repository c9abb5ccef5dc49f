"""Under any order of steps, repetitions and failures, no step works on an invalid result."""

import tempfile
from pathlib import Path

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule
from plain_steps import plain_order, plain_steps
from recording_cell import RecordingCell

from procedures.engine.context import StepContext
from procedures.engine.run_folder import read_run
from procedures.engine.step import Outcome, StepKey, StepSpec
from procedures.results.errors import StepRefused
from procedures.results.result import StepResult
from ronna_hw.errors import LinkTimeout

NAMES = [str(key) for key in plain_order().sequence]


class AnyOrder(RuleBasedStateMachine):
    """An engine that is told to run any step at any time. The model beside it is as simple as can be."""

    def __init__(self) -> None:
        super().__init__()
        self._folder = tempfile.TemporaryDirectory(prefix="any-order-")
        self.cell = RecordingCell(Path(self._folder.name))
        self.fail_next = False
        self.read: dict[str, str] = {}  # identifiers and hashes that the step that runs has read
        self.inside: str | None = None  # the trajectory in which the instrument is
        works = {spec.name: self.work(spec) for spec in plain_steps()}
        self.engine = self.cell.engine(plain_order(**works))
        self.files: dict[str, bytes] = {}

    def work(self, spec: StepSpec[StepResult]):
        def run(context: StepContext) -> Outcome[StepResult]:
            if self.fail_next:
                raise LinkTimeout("drawn")
            self.read = {}
            for model in spec.reads:
                context.result(model)
                stored = self.cell.case.find(model, context.key.trajectory)
                assert stored is not None
                self.read[stored.record.identifier] = stored.record.sha256
            self.follow_instrument(context.key)
            return Outcome(spec.result())

        return run

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
        told = {record.identifier for record in run.records} - run.superseded
        assert told == {stored.record.identifier for stored in self.cell.case.standing}

    def teardown(self) -> None:
        self.cell.journal.close()
        self._folder.cleanup()


TestAnyOrder = AnyOrder.TestCase
TestAnyOrder.settings = settings(max_examples=10, stateful_step_count=40, deadline=None)


@pytest.mark.slow
class TestManyOrders(AnyOrder.TestCase):
    settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
