"""The report states how a run ended, whatever became of it."""

from __future__ import annotations

import contextlib
import json
from collections.abc import Sequence
from pathlib import Path

import pytest
from clinical_case import ClinicalCell
from plain_steps import Work, plain_order
from user_commands import in_this_process

from procedures.cli.procedure import app
from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.order import Outcome
from procedures.journal.errors import GateFailed, StepRefused
from procedures.journal.journal import JOURNAL_FILE, ONLY_LEAVING, Entry, JournalValue
from procedures.journal.results import StepResult
from procedures.operator.errors import OperatorAborted
from procedures.reporting.ending import Ending, advise, ending_of, name_next_command, resumes
from procedures.reporting.outcome import RunError
from procedures.reporting.report import write_report
from procedures.reporting.run_reading import read_for_report
from procedures.runs.finishing import seal_run
from ronna_hw.evidence.manifest import KEPT_PLAN
from ronna_hw.roles import MASTER


def raising(problem: BaseException) -> Work:
    def work(_context: StepContext) -> Outcome[StepResult]:
        raise problem

    return work


@pytest.mark.parametrize(
    ("outcome", "problem", "word", "code"),
    [
        ("done", None, "done", ""),
        pytest.param(
            *("failed", GateFailed("too far off"), "failed", "PRO-007"), marks=pytest.mark.hazard(41)
        ),
        ("failed", OperatorAborted("enough"), "aborted", ""),
        ("interrupted", KeyboardInterrupt(), "interrupted", ""),
    ],
    ids=["completed", "step failed", "ended by the operator", "ended by a signal"],
)
def test_the_ending_is_named_with_the_code_of_its_error(
    cell: ClinicalCell, outcome: str, problem: BaseException | None, word: str, code: str
) -> None:
    works = {} if problem is None else {"fit": raising(problem)}
    engine = cell.engine(plain_order(**works))
    with contextlib.nullcontext() if problem is None else pytest.raises(type(problem)):
        engine.run_to()
    engine.close(outcome)
    seal_run(cell.folder)
    ending = ending_of(read_for_report(cell.folder))
    assert ending.sentence in write_report(cell.folder).read_text()
    assert (ending.word, ending.code) == (word, code)


def test_the_ending_of_a_completed_case_counts_its_stops_failures_and_resumes(cell: ClinicalCell) -> None:
    engine = cell.engine(plain_order())
    for code, what in (("EKI-010", "the arm was stopped: emergency stop is active"), ("TOOL-005", "bent")):
        cell.journal.write(Entry.FAILED, 1.0, step="tool_check", code=code, what=what)
    for _ in range(2):
        cell.journal.write(Entry.ACCEPTED, 2.0)
    engine.run_to()
    engine.close("done")
    seal_run(cell.folder)
    sentence = "Every step was done, after 1 emergency stop, 1 failed step (tool_check), 2 resumes."
    assert ending_of(read_for_report(cell.folder)).sentence == sentence


def test_a_stop_that_no_step_failed_by_counts_once_and_only_resumes_that_went_on_count(
    cell: ClinicalCell,
) -> None:
    engine = cell.engine(plain_order())
    stopped = "EKI-010: the arm was stopped: emergency stop is active"
    for entry in (Entry.FAILED, Entry.FAILED):
        cell.journal.write(entry, 1.0, step="tool_check", code="EKI-010", what=stopped)
    cell.journal.write(Entry.ACKNOWLEDGED, 2.0, device="arm", fault=stopped, by="Ann")
    cell.journal.write(Entry.REFUSED, 3.0, step="tool_change", unmet=["emergency stop: pressed"])
    cell.journal.write(Entry.ACKNOWLEDGED, 4.0, device="arm", fault="a message from before", by="Ann")
    for leaving in ({}, {}, {"only_leaving": True}):  # the first was not accepted
        cell.journal.write(Entry.RESTARTED, 5.0, begun=None, torn_bytes=0, orphans=[], **leaving)
    cell.journal.write(Entry.ACCEPTED, 6.0)
    cell.journal.write(Entry.RESTARTED, 7.0, begun=None, torn_bytes=0, orphans=[])
    cell.journal.write(Entry.ACCEPTED, 8.0)
    engine.run_to()
    engine.close("done")
    seal_run(cell.folder)
    reading = read_for_report(cell.folder)
    assert ending_of(reading).sentence == "Every step was done, after 2 emergency stops, 1 resume."
    assert resumes(reading.run.journal) == 1


@pytest.mark.parametrize(
    ("fault", "over"),
    [("EKI-010: stopped", " The fault was acknowledged by Ann."), ("NDI-008: link lost", "")],
    ids=["its fault", "another fault"],
)
def test_an_ending_by_a_fault_says_who_acknowledged_that_one(
    cell: ClinicalCell, fault: str, over: str
) -> None:
    engine = cell.engine(plain_order())
    cell.journal.write(Entry.FAILED, 1.0, step="fit:T1", code="EKI-010", what="The arm was stopped.")
    cell.journal.write(Entry.ACKNOWLEDGED, 2.0, device="arm", fault=fault, by="Ann")
    engine.close("failed")
    sentence = ending_of(read_for_report(cell.folder)).sentence
    assert sentence == f"fit:T1 failed. The arm was stopped.{over}"


def test_a_case_whose_last_step_may_not_begin_is_reported_as_refused(cell: ClinicalCell) -> None:
    engine: Engine = cell.engine(plain_order())
    with pytest.raises(StepRefused):
        engine.run_step(engine.order.find("fit:T1"))
    engine.close("failed")
    text = write_report(cell.folder).read_text()
    assert "Refused.</strong> fit:T1 was refused: image comes first" in text


def test_the_report_of_a_case_that_was_left_names_the_last_step(cell: ClinicalCell) -> None:
    engine = cell.engine(plain_order())
    engine.run_step(engine.order.find("image"))
    engine.close("left")
    assert "The operator left the case after image." in write_report(cell.folder).read_text()


def test_a_case_that_was_left_after_a_result_was_voided_names_the_last_step_that_stands(
    cell: ClinicalCell,
) -> None:
    engine = cell.engine(plain_order())
    engine.run_step(engine.order.find("image"))
    voided = engine.run_step(engine.order.find("localization:T1"))
    cell.journal.write(Entry.VOIDED, 1.0, supersedes=[voided.identifier])
    engine.close("left")
    assert ending_of(read_for_report(cell.folder)).sentence == "The operator left the case after image."


def test_a_changed_plan_of_a_sealed_run_is_named_without_reading_every_file(cell: ClinicalCell) -> None:
    plan = cell.folder / KEPT_PLAN
    plan.parent.mkdir(exist_ok=True)
    plan.write_text("schema = 1\n")
    engine = cell.engine(plain_order())
    engine.run_to()
    engine.close("done")
    seal_run(cell.folder)
    assert read_for_report(cell.folder, every_file=False).changes == ()
    plan.write_text("schema = 1\n\n")
    assert read_for_report(cell.folder, every_file=False).changes == ("case/plan.toml: changed",)


@pytest.mark.hazard(41)
def test_a_fault_found_after_the_last_step_is_reported_as_the_ending(cell: ClinicalCell) -> None:
    engine = cell.engine(plain_order())
    engine.run_to()
    engine.close("failed", GateFailed("the head has changed"))
    (row,) = json.loads(in_this_process(app, "list", cell.folder.parent, "--json").stdout)["runs"]
    assert row["ended"] == "failed"
    assert "the head has changed (PRO-007)" in write_report(cell.folder).read_text()


@pytest.mark.hazard(41)
def test_the_report_of_a_killed_run_names_the_step_it_was_in(cell: ClinicalCell) -> None:
    cell.journal.write(Entry.INTENT, 1.0, step="image", moves=False)
    text = write_report(cell.folder).read_text()
    assert "Killed.</strong> The program ended during image without closing the run" in text


@pytest.mark.hazard(41)
def test_the_report_of_a_run_killed_between_two_steps_names_the_one_that_was_done(cell: ClinicalCell) -> None:
    engine = cell.engine(plain_order())
    engine.run_step(engine.order.find("image"))
    text = write_report(cell.folder).read_text()
    assert "Killed.</strong> The program ended after image without closing the run" in text


def test_the_report_of_a_run_that_ended_before_its_theatre_was_open_gives_the_reason(tmp_path: Path) -> None:
    text = write_report(tmp_path, error=RunError(code="PRC-001", what="no theatre")).read_text()
    assert "before its theatre was open. no theatre (PRC-001)" in text
    assert "There is no journal" in text


@pytest.mark.hazard(39)
def test_records_before_a_broken_journal_line_are_shown_and_the_break_is_reported(registered: Path) -> None:
    path = registered / JOURNAL_FILE
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join([*lines[:-3], *lines[-2:]]))
    text = write_report(registered).read_text()
    assert "This folder is not as the run left it" in text
    assert "does not follow the line before it" in text
    assert "01-ct_import" in text


def test_a_torn_last_line_is_reported(registered: Path) -> None:
    path = registered / JOURNAL_FILE
    path.write_bytes(path.read_bytes()[:-5])
    assert "The last line of the journal is truncated" in write_report(registered).read_text()


@pytest.mark.hazard(39)
def test_a_changed_record_is_named(registered: Path) -> None:
    (changed,) = (registered / "records").glob("*-registration-T1.json")
    changed.write_text(changed.read_text().replace('"confidence": 0.95', '"confidence": 0.99'))
    text = write_report(registered).read_text()
    assert "This folder is not as the run left it" in text
    assert f"<li>records/{changed.name}: " in text


@pytest.mark.parametrize("resumable", [True, False])
@pytest.mark.parametrize(
    "word",
    [
        *("not begun", "failed", "refused", "aborted", "interrupted", "left", "killed", "in doubt", "missed"),
        *("not sealed", "error not determined"),
    ],
)
def test_every_ending_but_the_good_one_says_what_to_do(word: str, resumable: bool) -> None:
    assert advise(Ending(word, ""), resumable=resumable)
    assert advise(Ending("done", ""), resumable=resumable) == ""


@pytest.mark.parametrize(("is_out", "instrument_in"), [(False, "T1"), (True, None)])
def test_a_run_whose_program_was_killed_says_whether_an_instrument_was_inside(
    cell: ClinicalCell, is_out: bool, instrument_in: str | None
) -> None:
    def work(context: StepContext) -> Outcome[StepResult]:
        context.workcell.master.instrument.record_insertion("T1")
        if is_out:
            context.workcell.master.instrument.record_removal()
        raise GateFailed("killed here")

    with pytest.raises(GateFailed):
        cell.engine(plain_order(fit=work)).run_to()
    ending = ending_of(read_for_report(cell.folder))
    assert (ending.word, ending.instrument_in) == ("killed", instrument_in)


@pytest.mark.parametrize(
    ("lines", "place"),
    [
        ((), "at home"),
        (((Entry.MOTION, {"what": "go", "number": 1}),), "at no known place"),
        (
            (
                (Entry.MOTION, {"what": "go", "number": 1}),
                (Entry.MOVED, {"number": 1, "joints_rad": [0.0] * 6, "at_home": False}),
            ),
            "away from home",
        ),
    ],
    ids=["at rest", "while it moved", "on the way"],
)
def test_a_killed_run_is_shown_with_the_place_of_its_arm_and_the_commands_that_go_on(
    cell: ClinicalCell, lines: Sequence[tuple[Entry, dict[str, JournalValue]]], place: str
) -> None:
    cell.journal.write(Entry.PLACED, 1.0, arm=MASTER, joints_rad=[0.0] * 6, at_home=True)
    for entry, values in lines:
        cell.journal.write(entry, 2.0, arm=MASTER, **values)
    shown = in_this_process(app, "show", cell.folder).stdout
    assert f"by the journal, the arm is {place}" in shown
    for command in ("resume", "home"):
        assert f"ronna-procedure {command} {cell.folder}" in shown
    assert f"next: ronna-procedure resume {cell.folder}" in shown.splitlines()
    listed = in_this_process(app, "list", cell.folder.parent).stdout
    assert f"by the journal, the arm is {place}" in listed
    assert f"next: ronna-procedure resume {cell.folder}" in listed


@pytest.mark.parametrize(
    ("is_out", "inside"),
    [(False, "an instrument is still in T1"), (True, "nothing is inside the patient")],
)
def test_a_killed_run_is_listed_with_what_may_be_inside(
    cell: ClinicalCell, is_out: bool, inside: str
) -> None:
    cell.journal.write(Entry.INSTRUMENT, 1.0, arm=MASTER, trajectory="T1", inside=True)
    if is_out:
        cell.journal.write(Entry.INSTRUMENT, 2.0, arm=MASTER, trajectory="T1", inside=False)
    assert f"; {inside}; next: " in in_this_process(app, "list", cell.folder.parent).stdout
    assert f"by the journal, {inside}" in in_this_process(app, "show", cell.folder).stdout.splitlines()


def test_a_case_that_its_operator_ended_goes_home_next_if_its_arm_is_out() -> None:
    def next_command(word: str, *, resumable: bool = True, is_arm_out: bool = True) -> str:
        ending = Ending(word, "")
        return name_next_command(ending, resumable=resumable, is_arm_out=is_arm_out, run="RUN")

    assert next_command("aborted") == "ronna-procedure home RUN"
    assert next_command("aborted", is_arm_out=False) == ""
    assert next_command("failed") == "ronna-procedure resume RUN"
    assert next_command("failed", resumable=False) == ""
    assert next_command("done") == ""


@pytest.mark.parametrize(
    ("entries", "done"),
    [
        ((Entry.HOME,), "The arm was sent home"),
        ((Entry.ACKNOWLEDGED,), "A fault was acknowledged"),
        ((), "Nothing was moved"),
    ],
    ids=["home", "acknowledge", "at home already"],
)
def test_a_run_that_was_only_sent_home_was_left_by_nobody(
    cell: ClinicalCell, entries: tuple[Entry, ...], done: str
) -> None:
    engine = cell.engine(plain_order())
    engine.run_step(engine.order.find("image"))
    for time_s, entry in enumerate((Entry.RESTARTED, *entries), start=5):
        cell.journal.write(entry, time_s, **({ONLY_LEAVING: True} if entry is Entry.RESTARTED else {}))
    engine.close("left")
    assert ending_of(read_for_report(cell.folder)).sentence == f"{done} after image, and no step was run."


@pytest.mark.parametrize(
    ("outcome", "then"),
    [
        ("left", "The arm was sent home later, and no step was run."),
        ("failed", "A later attempt to go home did not succeed: PRO-032, not accepted."),
    ],
)
def test_a_way_home_keeps_the_ending_of_an_interrupted_run(
    cell: ClinicalCell, outcome: str, then: str
) -> None:
    engine = cell.engine(plain_order(image=raising(KeyboardInterrupt())))
    with pytest.raises(KeyboardInterrupt):
        engine.run_step(engine.order.find("image"))
    cell.journal.write(Entry.CLOSED, 5.0, outcome="interrupted")
    cell.journal.write(Entry.RESTARTED, 6.0, **{ONLY_LEAVING: True})
    cell.journal.write(Entry.HOME, 7.0)
    error = {"code": "PRO-032", "what": "not accepted"} if outcome == "failed" else {}
    cell.journal.write(Entry.CLOSED, 8.0, outcome=outcome, **error)
    ending = ending_of(read_for_report(cell.folder))
    assert (ending.word, ending.sentence) == ("interrupted", f"It was interrupted during image. {then}")


@pytest.mark.hazard(41)
def test_a_case_left_after_a_failed_step_names_what_failed_first(cell: ClinicalCell) -> None:
    engine = cell.engine(plain_order(fit=raising(GateFailed("too far off"))))
    with pytest.raises(GateFailed):
        engine.run_to()
    engine.close("left")
    seal_run(cell.folder)
    ending = ending_of(read_for_report(cell.folder))
    assert (ending.word, ending.code) == ("left", "PRO-007")
    assert ending.sentence.startswith("fit:T1 failed. PRO-007: too far off.")
    assert ending.sentence.endswith(". The operator then left the case.")
