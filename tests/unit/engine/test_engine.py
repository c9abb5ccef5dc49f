import json
import os
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest
from coded_errors import raises
from plain_steps import Fit, Image, Localization, ends_away, leaves, plain_order
from recording_cell import RecordingCell, RecordingOperator

from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.errors import WRONG_RESULT
from procedures.engine.events import Questioned
from procedures.engine.order import Outcome
from procedures.engine.run_folder import close_run
from procedures.engine.setting import ClinicalInput
from procedures.journal.errors import JournalNotWritable, StepRefused
from procedures.journal.journal import JOURNAL_FILE, Entry, Journal, JournalValue, read_journal
from procedures.journal.results import StepResult
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Question, Topic
from procedures.strategies.catalogue import find_strategy
from ronna_hw.errors import LinkTimeout
from ronna_hw.records import BadRecord, read_record


def run_to(engine: Engine, *names: str) -> Engine:
    for name in names:
        engine.run_to(engine.order.find(name))
    return engine


def run(engine: Engine, *names: str) -> Engine:
    for name in names:
        engine.run_step(engine.order.find(name))
    return engine


def test_the_intent_is_journalled_before_the_work_and_the_result_after_it(cell: RecordingCell) -> None:
    seen: list[list[tuple[str, str]]] = []

    def work(_context: StepContext) -> Outcome[StepResult]:
        seen.append(cell.entries())
        return Outcome(Image())

    run(cell.engine(plain_order(image=work)), "image")
    assert seen == [[("intent", "image")]]
    assert cell.entries()[-1] == ("result", "image")
    assert cell.room.announced == ["image"]


def test_the_parents_of_a_result_are_the_records_its_step_read(cell: RecordingCell) -> None:
    engine = cell.engine(plain_order())
    first = engine.run_step(engine.order.find("image"))
    second = engine.run_step(engine.order.find("localization:T1"))
    assert second.parents == {first.identifier: first.sha256}
    assert (second.identifier, second.trajectory) == ("02-localization-T1", "T1")


@pytest.mark.parametrize("ask", [StepContext.identifier, StepContext.doubt, StepContext.keep])
def test_whatever_is_asked_of_a_result_makes_it_a_parent(
    cell: RecordingCell, ask: Callable[[StepContext, type[Image]], object]
) -> None:
    def asks(context: StepContext) -> Outcome[StepResult]:
        ask(context, Image)
        return Outcome(Localization())

    engine = cell.engine(plain_order(localization=asks))
    image = engine.run_step(engine.order.find("image"))
    assert engine.run_step(engine.order.find("localization:T1")).parents == {image.identifier: image.sha256}


def test_a_standing_result_of_another_trajectory_is_a_parent_where_it_is_used(cell: RecordingCell) -> None:
    def uses_first(context: StepContext) -> Outcome[StepResult]:
        if context.stands(Localization):
            context.result_among(Localization, lambda found: found[0])
        return Outcome(Localization())

    engine = cell.engine(plain_order(localization=uses_first))
    run(engine, "image")
    first = engine.run_step(engine.order.find("localization:T1"))
    assert first.parents == {}
    assert engine.run_step(engine.order.find("localization:T2")).parents == {first.identifier: first.sha256}
    again = engine.run_step(engine.order.find("localization:T2"))  # of two it looks at, it uses one
    assert again.parents == {first.identifier: first.sha256}


def test_a_standing_result_whose_file_was_changed_is_not_handed_out(cell: RecordingCell) -> None:
    def uses_last(context: StepContext) -> Outcome[StepResult]:
        context.result_among(Localization, lambda found: found[-1] if found else None)
        return Outcome(Localization())

    engine = cell.engine(plain_order(localization=uses_last))
    run(engine, "image")
    first = engine.run_step(engine.order.find("localization:T1"))
    path = cell.folder / "records" / f"{first.identifier}.json"
    path.chmod(0o644)
    path.write_text(path.read_text().replace(first.created, "2020-01-01T00:00:00+00:00"))
    with pytest.raises(BadRecord, match="REC-001"):
        run(engine, "localization:T2")


def test_a_record_that_was_not_read_is_not_a_parent(cell: RecordingCell) -> None:
    engine = cell.engine(plain_order(localization=leaves(Localization)))
    run(engine, "image")
    assert engine.run_step(engine.order.find("localization:T1")).parents == {}


def test_a_step_cannot_read_a_result_it_does_not_declare(cell: RecordingCell) -> None:
    engine = run_to(cell.engine(plain_order(tool_on=leaves(Image, Image))), "fit:T2")
    with raises(WRONG_RESULT, match="PRO-016: tool_on asks for image, which it does not declare"):
        run(engine, "tool_on")


def test_a_step_that_returns_the_wrong_model_fails_and_its_result_is_not_stored(cell: RecordingCell) -> None:
    engine = run_to(cell.engine(plain_order(localization=leaves(Fit))), "image")
    with raises(WRONG_RESULT, match="expected Localization, got Fit"):
        run(engine, "localization:T1")
    assert engine.machine.state == "held"
    assert [path.stem for path in (cell.folder / "records").iterdir()] == ["01-image"]


def test_a_refused_step_lists_its_unmet_conditions_and_is_journalled(cell: RecordingCell) -> None:
    engine = cell.engine(plain_order())
    with pytest.raises(StepRefused, match=r"fit:T1 cannot start: image comes first"):
        run(engine, "fit:T1")
    assert cell.entries() == [("refused", "fit:T1")]
    assert cell.room.announced == []


@pytest.mark.parametrize(
    ("problem", "entry"),
    [(LinkTimeout("the tracker is silent"), "failed"), (KeyboardInterrupt(), "interrupted")],
)
def test_a_step_that_fails_or_is_interrupted_stops_the_arm_and_if_failed_can_be_repeated(
    cell: RecordingCell, problem: BaseException, entry: str
) -> None:
    def ends(_context: StepContext) -> Outcome[StepResult]:
        cell.arm.activate()
        raise problem

    engine = cell.engine(plain_order(image=ends))
    with pytest.raises(type(problem)):
        run(engine, "image")
    assert cell.arm.stops == 1
    assert cell.entries()[-1] == (entry, "image")
    assert (engine.why_refused(engine.order.find("image")) == ()) is (entry == "failed")


def test_files_attached_to_an_error_are_kept_in_the_run_folder(cell: RecordingCell) -> None:
    def fail(_context: StepContext) -> Outcome[StepResult]:
        error = LinkTimeout("telegrams ceased")
        error.attachments["flight-record-robot.master.txt"] = "cycle  IPOC\n"
        raise error

    with pytest.raises(LinkTimeout):
        run(cell.engine(plain_order(image=fail)), "image")
    assert (cell.folder / "flight-record-robot.master.txt").read_text() == "cycle  IPOC\n"
    last = list(read_journal(cell.folder / JOURNAL_FILE))[-1]
    assert last["files"] == ["flight-record-robot.master.txt"]


def test_an_attachment_that_cannot_be_written_hides_neither_the_error_nor_the_other_files(
    cell: RecordingCell,
) -> None:
    (cell.folder / "blocked.txt").mkdir()

    def fail(_context: StepContext) -> Outcome[StepResult]:
        error = LinkTimeout("telegrams ceased")
        error.attachments |= {"blocked.txt": "", "cycles.txt": "cycle  IPOC\n"}
        raise error

    with pytest.raises(LinkTimeout, match="telegrams ceased"):
        run(cell.engine(plain_order(image=fail)), "image")
    last = list(read_journal(cell.folder / JOURNAL_FILE))[-1]
    assert (last["entry"], last["files"]) == ("failed", ["cycles.txt"])


def test_a_rejected_confirmation_fails_the_step_and_is_recorded_with_value_and_answer(
    cell: RecordingCell,
) -> None:
    def ask(context: StepContext) -> Outcome[StepResult]:
        context.confirm(Topic.REGISTRATION, "accept the registration", "0.21 mm rms")
        return Outcome(Image())

    cell.operator = RecordingOperator(Topic.REGISTRATION)
    with pytest.raises(NotConfirmed, match=r"PRO-002.*0\.21 mm rms"):
        run(cell.engine(plain_order(image=ask)), "image")
    confirmation = next(
        line for line in read_journal(cell.folder / JOURNAL_FILE) if line["entry"] == "confirmation"
    )
    assert (confirmation["value"], confirmation["answer"]) == ("0.21 mm rms", "no")


def test_closing_closes_the_devices_and_the_journal(cell: RecordingCell) -> None:
    cell.engine(plain_order()).close("done")
    assert cell.arm.state == "closed"
    assert cell.entries() == [("closed", "")]
    assert cell.journal.closed


@pytest.mark.hazard(33)
def test_a_step_whose_intent_cannot_be_journalled_is_not_announced(cell: RecordingCell) -> None:
    os.dup2(full := os.open("/dev/full", os.O_WRONLY), cell.journal._file)
    os.close(full)
    with pytest.raises(JournalNotWritable, match=r"PRO-003.*No space left"):
        run(cell.engine(plain_order()), "image")
    assert cell.room.announced == []


@pytest.mark.hazard(33)
def test_a_result_that_cannot_be_journalled_is_not_valid_and_holds_the_case(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    engine = cell.engine(plain_order())
    write = cell.journal.write

    def refuse(entry: Entry, theatre_time_s: float, **data: object) -> None:
        if entry is Entry.RESULT:
            raise JournalNotWritable("cannot write journal.jsonl: No space left on device")
        write(entry, theatre_time_s, **data)  # type: ignore[arg-type]

    monkeypatch.setattr(cell.journal, "write", refuse)
    with pytest.raises(JournalNotWritable, match="PRO-003"):
        run(engine, "image")
    assert engine.machine.state == "held"
    assert engine.course.status(engine.order.find("image")) == "next"


@pytest.mark.hazard(33)
def test_deletion_of_the_run_folder_is_named_whatever_the_step_missed_first(cell: RecordingCell) -> None:
    engine = cell.engine(plain_order())
    run(engine, "image")
    shutil.rmtree(cell.folder)
    with pytest.raises(JournalNotWritable, match="PRO-053"):
        run(engine, "localization:T1")
    with pytest.raises(JournalNotWritable, match="PRO-053"):
        engine.retreat_home()
    assert cell.arm.motions == []


@pytest.mark.hazard(33)
def test_an_answer_that_cannot_be_journalled_does_not_count_and_leaves_no_question_open(
    cell: RecordingCell,
) -> None:
    engine = cell.engine(plain_order())
    os.dup2(full := os.open("/dev/full", os.O_WRONLY), cell.journal._file)
    os.close(full)
    with pytest.raises(JournalNotWritable, match="PRO-003"):
        engine.ask(Question(Topic.REPEAT, "repeat image", "supersedes nothing"))
    shown = [event.what for event in engine.events.subscribe().read(0).events]
    assert not any(isinstance(what, Questioned) for what in shown)


@pytest.mark.hazard(33)
def test_an_interrupt_during_a_motion_ends_the_case_also_without_a_journal(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **_more: object) -> None:
        raise JournalNotWritable("cannot write journal.jsonl: No space left on device")

    def interrupted(*_: object, **_more: object) -> None:
        monkeypatch.setattr(cell.journal, "note", full)
        monkeypatch.setattr(cell.journal, "write", full)
        raise KeyboardInterrupt

    engine = cell.engine(plain_order(image=ends_away))
    monkeypatch.setattr(cell.arm, "move", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(engine, "image")
    assert engine.machine.state == "aborted"


def test_an_interrupt_while_the_intent_is_written_is_journalled(
    cell: RecordingCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    write = cell.journal.write

    def interrupt(entry: Entry, theatre_time_s: float, **data: object) -> None:
        write(entry, theatre_time_s, **data)  # type: ignore[arg-type]
        if entry is Entry.INTENT:
            raise KeyboardInterrupt

    monkeypatch.setattr(cell.journal, "write", interrupt)
    with pytest.raises(KeyboardInterrupt):
        run(cell.engine(plain_order()), "image")
    assert cell.entries() == [("intent", "image"), ("interrupted", "image")]


@pytest.mark.hazard(1)
def test_a_repeated_step_supersedes_the_results_derived_from_its_former_one(cell: RecordingCell) -> None:
    engine = run_to(cell.engine(plain_order()), "fit:T2")
    run(engine, "localization:T1")
    last = list(read_journal(cell.folder / JOURNAL_FILE))[-1]
    assert last["supersedes"] == ["02-localization-T1", "03-fit-T1"]
    assert engine.course.status(engine.order.find("fit:T1")) == "next"
    assert engine.why_refused(engine.order.find("tool_on")) == ("fit:T1 comes first",)


def test_repeating_steps_keeps_every_record_named_in_the_journal(cell: RecordingCell) -> None:
    engine = run(run_to(cell.engine(plain_order()), "fit:T2"), *("localization:T1", "fit:T1") * 2)
    said = [line for line in read_journal(cell.folder / JOURNAL_FILE) if line["entry"] == Entry.RESULT]
    kept = {path.stem: read_record(path).sha256 for path in (cell.folder / "records").glob("*.json")}
    assert {line["record"]: line["sha256"] for line in said} == kept
    assert len(said) == len(kept) == 9
    assert engine.machine.state == "operation.fit"


def edit_number(path: Path) -> None:
    content = json.loads(path.read_text())
    content["payload"]["number"] = 7
    path.write_text(json.dumps(content))


@pytest.mark.hazard(1)
@pytest.mark.parametrize("spoil", [edit_number, Path.unlink])
def test_a_record_edited_or_removed_during_the_run_is_refused(
    cell: RecordingCell, spoil: Callable[[Path], None]
) -> None:
    engine = run(cell.engine(plain_order()), "image")
    spoil(cell.folder / "records" / "01-image.json")
    with pytest.raises(BadRecord, match="REC-001"):
        run(engine, "localization:T1")


def test_recorders_are_closed_before_the_journal_is_closed(cell: RecordingCell) -> None:
    lines_then: list[str] = []

    class Beside:
        def close(self) -> None:
            lines_then.extend(kind for kind, _ in cell.entries())

    engine = Engine(plain_order(), cell.case, cell.setting(), cell.journal, recorders=(Beside(), Beside()))
    engine.run_step(engine.order.sequence[0])
    engine.close("left")
    assert lines_then == ["intent", "result"] * 2
    assert cell.entries()[-1][0] == "closed"


def test_recordings_are_saved_before_the_result_is_journalled(cell: RecordingCell) -> None:
    lines_then: list[str] = []

    def settle() -> dict[str, JournalValue]:
        lines_then.extend(kind for kind, _ in cell.entries())
        return {"beside": "kept"}

    engine = Engine(plain_order(), cell.case, cell.setting(), cell.journal, before_result=settle)
    engine.run_step(engine.order.sequence[0])
    assert lines_then == ["intent"]
    assert list(read_journal(cell.journal.path))[-1]["beside"] == "kept"


def test_ct_plan_and_proposed_place_outside_the_run_are_recorded_by_hash(tmp_path: Path) -> None:
    case, run = tmp_path / "case", tmp_path / "run"
    (case / "ct").mkdir(parents=True)
    run.mkdir()
    files = [case / "ct" / "1.dcm", case / "plan.toml", case / "place.json"]
    for one in files:
        one.write_text(one.name)
    clinical = ClinicalInput(case / "ct", case / "plan.toml", find_strategy("ocs"))
    close_run(run, Journal(run), 0.0, "done", clinical)
    last = json.loads((run / JOURNAL_FILE).read_text().splitlines()[-1])
    assert set(last["inputs"]) == {str(one) for one in files}
