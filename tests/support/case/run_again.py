"""A cell whose run ended, opened again as a program finds it after a restart."""

from __future__ import annotations

from typing import TypeVar

from recording_cell import RecordingCell

from procedures.engine.engine import Engine
from procedures.engine.order import CaseOrder
from procedures.journal.journal import Journal
from procedures.runs.interrupted_run import InterruptedRun, read_interrupted_run

C = TypeVar("C", bound=RecordingCell)


def broken_off(cell: RecordingCell) -> None:
    """The program is gone, and its file of the journal with it."""
    cell.journal.close()


def opened_again(cell: C, order: CaseOrder) -> tuple[C, Engine, InterruptedRun]:
    """New devices, which stand where the old ones stood, and an engine in recovery over what was left."""
    left = read_interrupted_run(cell.folder)
    journal = cell.folder / "journal.jsonl"
    aside = journal.rename(journal.with_name("aside"))
    again = type(cell)(cell.folder, theatre=cell.theatre)
    again.journal.close()
    aside.replace(journal)
    again.journal = Journal.reopen_run(cell.folder, left.chain)
    again.case = left.restore_case(order)
    again.arm.joints_rad, again.arm.mounted = cell.arm.joints_rad, cell.arm.mounted
    again.workcell = again.make_workcell(history=left.arm)
    engine = Engine(
        order, again.case, again.setting(), again.journal, recovering=not left.untouched, latest=left.latest
    )
    return again, engine, left
