from pathlib import Path
from typing import Any, cast

import pytest

from procedures.engine.case import Case
from procedures.engine.devices import DeviceSet
from procedures.engine.engine import Engine
from procedures.engine.errors import JournalNotWritable, NotConfirmed, StepRefused, UnknownStep
from procedures.engine.journal import JOURNAL_FILE, Entry, Journal, read_journal
from procedures.engine.operator import Question
from procedures.engine.order import LOCALIZING, PHASES, TARGETING
from procedures.engine.step import Outcome, StepContext, StepSpec
from ronna_hw.clock import HostClock
from ronna_hw.config import TheatreFile
from ronna_hw.errors import LinkTimeout
from ronna_hw.records import read_record


class Arm:
    """Notes when it is stopped; that is all the engine may do with it."""

    def __init__(self) -> None:
        self.stops = 0
        self.closed = False


class Devices:
    def __init__(self) -> None:
        self.arm = Arm()

    def stop(self) -> None:
        self.arm.stops += 1

    def close(self) -> None:
        self.arm.closed = True


class Doubter:
    """An operator who answers as told and remembers what was announced."""

    def __init__(self, answer: bool = True) -> None:
        self.answer = answer
        self.heard: list[str] = []

    def announce(self, step: str) -> None:
        self.heard.append(step)

    def confirm(self, question: Question) -> bool:
        return self.answer

    def change_tool(self, number: int, description: str) -> None:
        raise AssertionError("no tool is changed here")


def _theatre() -> TheatreFile:
    return cast("TheatreFile", type("Theatre", (), {"calibration": object(), "procedure": None})())


STEPS = {
    "ct_import": StepSpec("ct_import", "", (), lambda _c: Outcome({"slices": 3}, summary="3 slices")),
    "fiducial_localization": StepSpec(
        "fiducial_localization", "", ("ct_import",), lambda c: Outcome({"n": 5}, (c.case.get("ct_import"),))
    ),
}


@pytest.fixture
def make(tmp_path: Path) -> Any:
    def build(steps: dict[str, StepSpec] | None = None, operator: Doubter | None = None) -> Engine:
        return Engine(
            steps=steps or STEPS,
            trajectories=(),
            case=Case(tmp_path, tmp_path / "ct", tmp_path / "plan.toml"),
            theatre=_theatre(),
            devices=cast("DeviceSet", Devices()),
            clock=HostClock(),
            operator=operator or Doubter(),
            journal=Journal(tmp_path),
        )

    return build


def _entries(folder: Path) -> list[tuple[str, str]]:
    return [(line["entry"], line.get("step", "")) for line in read_journal(folder / JOURNAL_FILE)]


def test_the_intent_is_in_the_journal_before_the_work_and_the_result_after_it(
    make: Any, tmp_path: Path
) -> None:
    seen_by_step: list[list[tuple[str, str]]] = []

    def work(_context: StepContext) -> Outcome:
        seen_by_step.append(_entries(tmp_path))
        return Outcome({})

    engine = make({**STEPS, "ct_import": StepSpec("ct_import", "", (), work)})
    engine.run_step(engine.find("ct_import"))
    assert seen_by_step == [[("intent", "ct_import")]]
    assert _entries(tmp_path)[-1] == ("result", "ct_import")


def test_a_result_is_a_record_with_its_parents(make: Any) -> None:
    engine = make()
    first = engine.run_step(engine.find("ct_import"))
    second = engine.run_step(engine.find("fiducial_localization"))
    assert second.parents == (first.identifier,)
    assert engine.finished == engine.sequence[:2]


def test_a_step_out_of_order_is_refused_with_every_unmet_precondition(make: Any, tmp_path: Path) -> None:
    engine = make()
    with pytest.raises(StepRefused, match="may not follow idle; no result of ct_import"):
        engine.run_step(engine.find("fiducial_localization"))
    assert _entries(tmp_path) == [("refused", "fiducial_localization")]
    assert engine.operator.heard == []


def test_an_unknown_step_names_those_that_exist(make: Any) -> None:
    with pytest.raises(UnknownStep, match="ct_import, fiducial_localization"):
        make().find("drilling")


def test_a_step_that_fails_stops_the_arm_and_leaves_the_chart_in_fault(make: Any, tmp_path: Path) -> None:
    def fail(_context: StepContext) -> Outcome:
        raise LinkTimeout("the tracker is silent")

    engine = make({**STEPS, "ct_import": StepSpec("ct_import", "", (), fail)})
    with pytest.raises(LinkTimeout):
        engine.run_step(engine.find("ct_import"))
    assert engine.devices.arm.stops == 1
    assert engine.machine.state == "fault"
    assert _entries(tmp_path)[-1] == ("failed", "ct_import")


def test_evidence_that_comes_with_an_error_is_kept_in_the_run_folder(make: Any, tmp_path: Path) -> None:
    def fail(_context: StepContext) -> Outcome:
        error = LinkTimeout("telegrams ceased")
        error.attachments["flight-record-robot.master.txt"] = "cycle  IPOC\n"
        raise error

    engine = make({**STEPS, "ct_import": StepSpec("ct_import", "", (), fail)})
    with pytest.raises(LinkTimeout):
        engine.run_step(engine.find("ct_import"))
    assert (tmp_path / "flight-record-robot.master.txt").read_text() == "cycle  IPOC\n"
    last = list(read_journal(tmp_path / JOURNAL_FILE))[-1]
    assert last["files"] == ["flight-record-robot.master.txt"]


def test_an_interrupted_step_stops_the_arm_and_is_journalled(make: Any, tmp_path: Path) -> None:
    def interrupt(_context: StepContext) -> Outcome:
        raise KeyboardInterrupt

    engine = make({**STEPS, "ct_import": StepSpec("ct_import", "", (), interrupt)})
    with pytest.raises(KeyboardInterrupt):
        engine.run_step(engine.find("ct_import"))
    assert engine.devices.arm.stops == 1
    assert _entries(tmp_path)[-1] == ("interrupted", "ct_import")


def test_without_a_yes_a_confirmed_value_goes_no_further_and_both_are_recorded(
    make: Any, tmp_path: Path
) -> None:
    def ask(context: StepContext) -> Outcome:
        context.confirm("accept the registration", "0.21 mm rms")
        return Outcome({})

    engine = make({**STEPS, "ct_import": StepSpec("ct_import", "", (), ask)}, Doubter(answer=False))
    with pytest.raises(NotConfirmed, match=r"PRO-002.*0\.21 mm rms"):
        engine.run_step(engine.find("ct_import"))
    confirmation = next(
        line for line in read_journal(tmp_path / JOURNAL_FILE) if line["entry"] == "confirmation"
    )
    assert (confirmation["value"], confirmation["answer"]) == ("0.21 mm rms", False)


def test_closing_ends_the_sessions_and_the_journal(make: Any, tmp_path: Path) -> None:
    engine = make()
    engine.close("done")
    assert engine.devices.arm.closed
    assert _entries(tmp_path) == [("closed", "")]


@pytest.mark.hazard(33)
def test_when_the_result_cannot_be_journalled_the_arm_is_stopped_and_nothing_follows(make: Any) -> None:
    engine = make()

    def write(entry: Entry, _theatre_time_s: float, **_data: Any) -> None:
        if entry is Entry.RESULT:
            raise JournalNotWritable("cannot write journal.jsonl: No space left on device")

    engine.journal.write = write
    with pytest.raises(JournalNotWritable, match="PRO-003"):
        engine.run_step(engine.find("ct_import"))
    assert engine.devices.arm.stops == 1
    assert engine.machine.state == "fault"
    assert engine.finished == ()


def test_an_interruption_while_the_intent_is_written_stops_the_arm_and_is_journalled(
    make: Any, tmp_path: Path
) -> None:
    engine = make()
    original = engine.journal.write

    def write(entry: Entry, theatre_time_s: float, **data: Any) -> None:
        original(entry, theatre_time_s, **data)
        if entry is Entry.INTENT:
            raise KeyboardInterrupt

    engine.journal.write = write
    with pytest.raises(KeyboardInterrupt):
        engine.run_step(engine.find("ct_import"))
    assert engine.devices.arm.stops == 1
    assert _entries(tmp_path)[-2:] == [("intent", "ct_import"), ("interrupted", "ct_import")]


ORDER = (*(name for phase in PHASES.values() for name in phase),)
PER_TRAJECTORY = (*LOCALIZING, *TARGETING)


def _chain(tmp_path: Path) -> Engine:
    """A case of two trajectories whose steps do nothing but leave results, each made from the one before."""

    def work(name: str) -> StepSpec:
        def run(context: StepContext) -> Outcome:
            kinds = {"registration": "relocalization", "tool_change": "", "positioning": "registration"}
            kind = kinds.get(name, "")
            return Outcome({}, (context.result(kind),) if kind else ())

        needs = {
            "positioning": ("registration", "tool_change"),
            "at_target": ("positioning",),
            "retreat": ("positioning", "at_target"),
        }.get(name, ())
        everything = ("registration",) if name == "tool_change" else ()
        return StepSpec(name, "", needs, run, name in PER_TRAJECTORY, everything)

    return Engine(
        steps={name: work(name) for name in ORDER},
        trajectories=("T1", "T2"),
        case=Case(tmp_path, tmp_path / "ct", tmp_path / "plan.toml"),
        theatre=_theatre(),
        devices=cast("DeviceSet", Devices()),
        clock=HostClock(),
        operator=Doubter(),
        journal=Journal(tmp_path),
    )


def test_with_the_guide_at_one_target_the_retreat_of_another_trajectory_is_refused(tmp_path: Path) -> None:
    engine = _chain(tmp_path)
    engine.run_to(engine.find("at_target:T2"))
    with pytest.raises(StepRefused, match="retreat:T1 may not begin: it may not follow at_target:T2"):
        engine.run_step(engine.find("retreat:T1"))
    assert engine.why_refused(engine.find("retreat:T2")) == ()


def test_a_registration_whose_localization_was_repeated_is_superseded_and_moves_nothing(
    tmp_path: Path,
) -> None:
    engine = _chain(tmp_path)
    engine.run_to(engine.find("registration:T2"))
    engine.run_step(engine.find("relocalization:T1"))
    with pytest.raises(StepRefused, match="it may not follow relocalization:T1"):
        engine.run_step(engine.find("registration:T2"))
    assert not engine.case.has("registration", "T1")
    assert engine.upcoming == engine.find("registration:T1")
    assert "no result of registration for T1" in engine.why_refused(engine.find("tool_change"))


def test_repeating_a_step_leaves_the_record_of_its_former_result_as_it_was(tmp_path: Path) -> None:
    engine = _chain(tmp_path)
    engine.run_to(engine.find("registration:T2"))
    for name in ("relocalization:T1", "registration:T1") * 2:
        engine.run_step(engine.find(name))
    told = [line for line in read_journal(tmp_path / JOURNAL_FILE) if line["entry"] == Entry.RESULT]
    kept = {path.stem: read_record(path).sha256 for path in (tmp_path / "records").glob("*.json")}
    assert {line["record"]: line["sha256"] for line in told} == kept
    assert len(told) == len(kept) == 15
