"""A run that broke off is read back in its last state and continues in the same journal."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from clinical_case import ClinicalCell, done_later
from coded_errors import raises
from plain_steps import Approach, Image, plain_order
from prepared_results import checked_plan
from recording_cell import RecordingCell
from run_again import broken_off, opened_again

from procedures.engine.case import StepKey
from procedures.engine.engine import Engine
from procedures.engine.errors import RUN_IN_USE
from procedures.engine.order import Outcome, order_of
from procedures.journal.errors import StepRefused
from procedures.journal.journal import JOURNAL_FILE, TORN_FILE, Entry, Journal
from procedures.journal.results import StepResult
from procedures.runs.case import restore_order
from procedures.runs.folders import hold_run
from procedures.runs.interrupted_run import read_interrupted_run
from procedures.runs.request import CaseProcedure
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import LinkTimeout
from ronna_hw.evidence.journal_reading import JournalCorrupt, read_chain
from ronna_hw.evidence.manifest import RECORDS_FOLDER

BLOCK_BYTES = 512


def lines_written(folder: Path, count: int) -> Path:
    journal = Journal(folder)
    for number in range(count):
        journal.write(Entry.FINDING, float(number), text=f"number {number}")
    journal.close()
    return folder / JOURNAL_FILE


@pytest.mark.hazard(39)
@pytest.mark.parametrize(
    "end",
    [b'{"sequence":3,"prev', b"\0" * BLOCK_BYTES, b'{"sequence":3' + b"\0" * 40, b"\0\n\0\n"],
    ids=["torn", "zeroed block", "torn and zeroed", "zeros and line ends"],
)
def test_a_torn_end_is_set_aside_and_the_chain_continues_before_it(tmp_path: Path, end: bytes) -> None:
    path = lines_written(tmp_path, 3)
    with path.open("ab") as file:
        file.write(end)
    chain = read_chain(path)
    assert (len(chain.lines), chain.torn) == (3, end)
    journal = Journal.reopen_run(tmp_path, chain)
    journal.write(Entry.RESTARTED, 9.0)
    journal.close()
    assert [line["entry"] for line in read_chain(path).lines] == ["finding"] * 3 + ["restarted"]
    assert end in (tmp_path / TORN_FILE).read_bytes()


@pytest.mark.parametrize("lost", range(1, 300, 23))
def test_the_lines_before_a_zeroed_last_block_are_read(tmp_path: Path, lost: int) -> None:
    path = lines_written(tmp_path, 8)
    content = path.read_bytes()
    path.write_bytes(content[:-lost] + b"\0" * lost)
    whole = content[:-lost].count(b"\n")
    assert len(read_chain(path).lines) == whole


@pytest.mark.hazard(39)
def test_a_broken_line_followed_by_whole_lines_is_not_a_torn_end(tmp_path: Path) -> None:
    path = lines_written(tmp_path, 4)
    content = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(content[0] + b"\0" * len(content[1]) + b"".join(content[2:]))
    with pytest.raises(JournalCorrupt, match="PRO-011"):
        read_chain(path)


def test_valid_results_stay_valid_and_superseded_ones_superseded(cell: RecordingCell) -> None:
    order = plain_order("T1")
    engine = cell.engine(order)
    engine.run_to(order.find("fit:T1"))
    engine.run_step(order.find("localization:T1"))  # supersedes the fit
    broken_off(cell)
    again, _, left = opened_again(cell, order)
    assert [stored.record for stored in again.case.valid_results] == [
        one.record for one in cell.case.valid_results
    ]
    assert again.case.was_superseded(StepKey("fit", "T1"))
    assert left.latest == StepKey("localization", "T1")


def test_no_step_starts_before_the_recovery_is_accepted(cell: RecordingCell) -> None:
    order = plain_order("T1")
    cell.engine(order).run_to(order.find("fit:T1"))
    broken_off(cell)
    again, engine, _ = opened_again(cell, order)
    with pytest.raises(StepRefused, match="accepted"):
        engine.run_to()
    assert again.arm.calls == again.arm.motions == []
    engine.accept()
    engine.run_to()
    assert engine.upcoming is None


def test_the_mandatory_successor_of_the_last_step_comes_next(cell: RecordingCell) -> None:
    order = plain_order("T1")
    cell.engine(order).run_to(order.find("approach:T1"))
    broken_off(cell)
    _, engine, left = opened_again(cell, order)
    assert left.latest == order.find("approach:T1")
    assert engine.upcoming == order.find("held:T1")


def in_a_step(_cell: RecordingCell, engine: Engine) -> None:
    with pytest.raises(LinkTimeout):
        engine.run_step(engine.order.find("fit:T1"))


def at_the_end(cell: RecordingCell, engine: Engine) -> None:
    cell.arm.state = Lifecycle.FAULT
    engine.close("left")


def acknowledged(cell: RecordingCell, engine: Engine) -> None:
    cell.arm.state = Lifecycle.FAULT
    engine.faults.acknowledge("A. Nurse")


def killed_while_it_is_acknowledged(cell: RecordingCell, engine: Engine) -> None:
    def killed(*_: object) -> None:
        raise MemoryError

    cell.arm.state = Lifecycle.FAULT
    cell.arm.recover = killed  # type: ignore[method-assign]
    with pytest.raises(MemoryError):
        engine.faults.acknowledge("A. Nurse")


@pytest.mark.hazard(2)
@pytest.mark.hazard(12)
@pytest.mark.parametrize("ended", [in_a_step, at_the_end, acknowledged, killed_while_it_is_acknowledged])
def test_a_localization_doubted_after_an_arm_fault_is_still_doubted_after_a_restart(
    cell: RecordingCell, ended: Callable[[RecordingCell, Engine], None]
) -> None:
    def fails(_context: object) -> Outcome[StepResult]:
        cell.arm.state = Lifecycle.FAULT
        raise LinkTimeout("the controller is silent")

    order = plain_order("T1", fit=fails)
    engine = cell.engine(order)
    engine.run_to(order.find("localization:T1"))
    ended(cell, engine)
    if not cell.journal.closed:
        broken_off(cell)
    again, _, _ = opened_again(cell, order)
    (localized,) = (one.record for one in again.case.valid_results if one.record.kind == "localization")
    assert again.case.doubt_of(localized) == "a fault of unknown cause (theatre time 0 s)"
    assert len(again.entries("doubted")) == 1


def test_a_record_missing_from_the_journal_is_not_used_but_kept(cell: RecordingCell) -> None:
    order = plain_order("T1")
    cell.engine(order).run_to(order.find("image"))
    cell.case.store(order.find("localization:T1"), Image(), ())  # killed between record and journal
    broken_off(cell)
    again, engine, left = opened_again(cell, order)
    assert left.orphans == ("02-localization-T1",)
    engine.accept()
    engine.run_to(order.find("localization:T1"))
    names = {path.stem for path in (again.folder / RECORDS_FOLDER).iterdir()}
    assert names == {"01-image", "02-localization-T1", "03-localization-T1"}


def test_the_step_that_had_started_is_known(cell: RecordingCell) -> None:
    def killed(_context: object) -> Outcome[StepResult]:
        broken_off(cell)
        raise MemoryError

    order = plain_order("T1", approach=killed)
    with pytest.raises(MemoryError):
        cell.engine(order).run_to()
    assert read_interrupted_run(cell.folder).begun == StepKey(Approach.kind, "T1")


@pytest.mark.hazard(42)
def test_a_run_is_held_by_one_program_which_is_named_to_others_with_no_advice_to_end_it(
    tmp_path: Path,
) -> None:
    with (
        hold_run(tmp_path),
        raises(RUN_IN_USE, match=rf"PRO-030.*pid {os.getpid()}") as refused,
        hold_run(tmp_path),
    ):
        pass
    assert "watch" in refused.value.advice
    assert "end" not in refused.value.advice.lower().split()
    with hold_run(tmp_path):
        pass


class Begun(StepResult, kind="begun"):
    """What was done before there was a plan."""


def test_the_order_comes_from_the_record_without_reading_a_plan_file(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path / "run")
    cell.begin(checked_plan()).run_to()
    broken_off(cell)
    order = restore_order(CaseProcedure(case=tmp_path / "gone"), read_interrupted_run(cell.folder))
    assert list(order.trajectories) == [trajectory.id for trajectory in checked_plan().plan.trajectories]
    assert StepKey("retreat", order.trajectories[-1]) in order.sequence


def test_an_order_without_a_checked_plan_has_no_steps_at_targets(tmp_path: Path) -> None:
    cell = ClinicalCell(tmp_path / "run")
    cell.engine(order_of([done_later(Begun())], ())).run_to()
    broken_off(cell)
    order = restore_order(CaseProcedure(case=tmp_path / "gone"), read_interrupted_run(cell.folder))
    assert order.trajectories == ()
