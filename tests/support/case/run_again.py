"""A cell whose run ended, opened again as a program finds it after a restart."""

from __future__ import annotations

from pathlib import Path
from typing import TypeVar

from recording_cell import RecordingCell

from procedures.engine.engine import Engine
from procedures.engine.order import CaseOrder
from procedures.journal.journal import JOURNAL_FILE, Journal
from procedures.runs.interrupted_run import InterruptedRun, read_interrupted_run
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE

C = TypeVar("C", bound=RecordingCell)


def broken_off(cell: RecordingCell) -> None:
    """The program is gone, and its file of the journal with it."""
    cell.journal.close()


def lose_lines(folder: Path, *, from_line_with: bytes) -> list[bytes]:
    """Cut the journal before that line, where the event file has every line; what is lost."""
    path = folder / JOURNAL_FILE
    lines = path.read_bytes().splitlines(keepends=True)
    events = (b'{"what":{"kind":"journal","line":' + line.strip() + b"}}\n" for line in lines)
    (folder / EVENTS_FILE).write_bytes(b"".join(events))
    first = next(number for number, line in enumerate(lines) if from_line_with in line)
    path.write_bytes(b"".join(lines[:first]))
    return lines[first:]


def opened_again(cell: C, order: CaseOrder) -> tuple[C, Engine, InterruptedRun]:
    """New devices, which stand where the old ones stood, and an engine in recovery over what was left."""
    left = read_interrupted_run(cell.folder)
    journal = cell.folder / "journal.jsonl"
    aside = journal.rename(journal.with_name("aside"))
    again = type(cell)(cell.folder, theatre=cell.theatre)
    again.journal.close()
    aside.replace(journal)
    again.journal = Journal.reopen_run(cell.folder, left.run.chain)
    again.case = left.restore_case(order)
    again.arm.joints_rad, again.arm.mounted = cell.arm.joints_rad, cell.arm.mounted
    again.workcell = again.make_workcell(history=left.arm)
    engine = Engine(
        order, again.case, again.setting(), again.journal, recovering=not left.untouched, latest=left.latest
    )
    return again, engine, left
