"""An input that was exchanged while a run was open, after results were made from it, is named."""

from __future__ import annotations

import hashlib
from pathlib import Path

import pytest
from coded_errors import raises
from finished_runs import changed_files
from plain_steps import Image, plain_order
from recording_cell import RecordingCell

from procedures.engine.context import StepContext
from procedures.engine.engine import Engine
from procedures.engine.order import Outcome
from procedures.journal.journal import Entry, Journal
from procedures.journal.results import StepResult
from procedures.runs.engine_setup import theatre_inputs
from procedures.runs.interrupted_run import read_interrupted_run
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.journal_reading import JOURNAL_FILE, RUN_CHANGED, read_chain
from ronna_hw.evidence.manifest import WITH_PORTS, hash_inputs, list_theatre_files

CT, TOOL = "case/ct/slice-1.dcm", "theatre/frame.rom"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    folder = tmp_path / "run"
    for name in (CT, TOOL):
        (folder / name).parent.mkdir(parents=True)
        (folder / name).write_text("as it was")
    return folder


@pytest.fixture
def engine(run: Path) -> Engine:
    return reading(run, run / CT, run / "case" / "unreadable")


def reading(run: Path, *files: Path) -> Engine:
    """A run whose first step has read these files."""

    def read(context: StepContext) -> Outcome[StepResult]:
        context.note_inputs(*files)
        return Outcome(Image())

    cell = RecordingCell(run)
    cell.journal.write(Entry.OPENED, 0.0, run=run.name, inputs=hash_inputs(run, list_theatre_files(run)))
    engine = cell.engine(plain_order("T1", image=read))
    engine.run_step(engine.order.find("image"))
    return engine


@pytest.mark.hazard(39)
@pytest.mark.parametrize("name", [CT, TOOL])
def test_an_input_exchanged_while_the_run_was_open_is_named(run: Path, engine: Engine, name: str) -> None:
    (run / name).write_text("another")
    engine.close("done")
    (problem,) = inspect_run(run).changes
    assert (
        str(problem) == f"{name}: exchanged while the run was open: its results were made from another file"
    )


@pytest.mark.hazard(39)
def test_a_slice_removed_while_the_run_was_open_is_named(run: Path, engine: Engine) -> None:
    (run / CT).unlink()
    engine.close("done")
    assert changed_files(run) == {CT}


def test_an_input_that_was_put_back_is_as_the_results_were_made_from_it(run: Path, engine: Engine) -> None:
    (run / CT).write_text("another")
    (run / CT).write_text("as it was")
    engine.close("done")
    assert changed_files(run) == set()


def test_a_repeated_step_is_made_from_the_input_as_it_is_then(run: Path, engine: Engine) -> None:
    (run / CT).write_text("another")
    engine.run_step(engine.order.find("image"))
    engine.close("done")
    assert changed_files(run) == set()


def test_an_input_out_of_reach_at_the_end_is_compared_when_it_is_back(run: Path, engine: Engine) -> None:
    aside = (run / CT).rename(run.with_name("aside"))
    engine.close("left")
    assert [problem.what for problem in inspect_run(run).changes] == ["missing"]
    aside.rename(run / CT)
    assert "exchanged" not in str(inspect_run(run).changes)
    (run / CT).write_text("another")
    assert "changed" in {problem.what for problem in inspect_run(run).changes if problem.file == CT}


def test_inputs_whose_folder_is_elsewhere_now_are_not_compared_and_the_run_is_whole(
    run: Path, tmp_path: Path
) -> None:
    patient = tmp_path / "patient"
    patient.mkdir()
    (patient / "slice-1.dcm").write_text("as it was")
    reading(run, *patient.iterdir()).close("done")
    aside = patient.rename(tmp_path / "archive")
    found = inspect_run(run)
    assert (found.changes, found.out_of_reach) == ((), (str(patient / "slice-1.dcm"),))
    aside.rename(patient)
    (patient / "slice-1.dcm").unlink()
    assert [str(problem) for problem in inspect_run(run).changes] == [f"{patient}/slice-1.dcm: missing"]


def test_an_input_changed_after_a_kill_is_told_and_left_to_the_resumed_run(run: Path, engine: Engine) -> None:
    (run / CT).write_text("another")
    found = inspect_run(run)
    assert f"{CT}: changed since results were made from it" in map(str, found.problems)
    assert found.changes == ()


def test_a_theatre_file_exchanged_before_a_kill_is_named_to_who_takes_the_run_up(
    run: Path, engine: Engine
) -> None:
    assert engine.upcoming is not None
    (run / TOOL).write_text("another")
    assert [str(problem) for problem in inspect_run(run).changes] == [f"{TOOL}: changed"]
    assert inspect_run(run).not_as_left == {TOOL: hashlib.sha256(b"as it was").hexdigest()}
    with raises(RUN_CHANGED):
        read_interrupted_run(run)


def test_a_theatre_file_with_the_ports_of_a_program_that_never_took_the_run_up_is_no_change(
    run: Path,
) -> None:
    (run / WITH_PORTS).write_text("port = 1")
    cell = RecordingCell(run)
    inputs = hash_inputs(run, list_theatre_files(run))
    cell.journal.write(Entry.OPENED, 0.0, run=run.name, inputs=inputs)
    (run / WITH_PORTS).write_text("port = 2")
    assert inspect_run(run).changes == ()


def test_a_plan_written_again_in_a_resumed_run_is_no_change_after_a_kill(run: Path, engine: Engine) -> None:
    engine.close("left")
    chain = read_chain(run / JOURNAL_FILE)
    (run / CT).write_text("the same, with a comment")
    record = next(line["record"] for line in chain.lines if line["entry"] == Entry.RESULT)
    journal = Journal.reopen_run(run, chain)
    journal.write(Entry.RESTARTED, 0.0, inputs=dict(hash_inputs(run, list_theatre_files(run))))
    again = dict(hash_inputs(run, [run / CT]))
    journal.write(Entry.FINDING, 0.0, text="written again", record=record, inputs=again)
    assert inspect_run(run).changes == ()
    (run / CT).write_text("another")
    assert f"{CT}: changed since results were made from it" in map(str, inspect_run(run).problems)


@pytest.mark.parametrize("in_place", [None, "a file"], ids=["nothing", "a file"])
def test_an_input_below_what_is_no_folder_is_out_of_reach(run: Path, in_place: str | None) -> None:
    elsewhere = run.with_name("patient")
    if in_place is not None:
        elsewhere.write_text(in_place)
    cell = RecordingCell(run)
    cell.journal.write(Entry.OPENED, 0.0, run=run.name)
    cell.journal.write(
        Entry.CLOSED, 0.0, outcome="done", files={}, inputs={f"{elsewhere}/plan.toml": "0" * 64}
    )
    assert inspect_run(run).out_of_reach == (f"{elsewhere}/plan.toml",)


def test_a_theatre_file_that_was_added_is_no_input_of_who_takes_the_run_up(run: Path) -> None:
    cell = RecordingCell(run)
    cell.journal.write(Entry.OPENED, 0.0, run=run.name)
    cell.engine(plain_order("T1")).close("left")
    (run / "theatre" / "backup.toml").write_text("from elsewhere")
    inputs = theatre_inputs(run, read_interrupted_run(run, only_leaving=True))
    assert list(inputs) == [TOOL]
