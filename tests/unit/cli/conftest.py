"""A small finished run, made in this process."""

from __future__ import annotations

from pathlib import Path

import pytest
from plain_steps import plain_order
from recording_cell import RecordingCell

from procedures.journal.journal import Entry
from procedures.runs.finishing import seal_run
from procedures.runs.request import CaseProcedure, RunRequest
from procedures.runs.request_file import write_request


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A finished run in the folder `runs`."""
    folder = tmp_path / "runs" / "20260101T000000-abcd"
    folder.parent.mkdir()
    cell = RecordingCell(folder)
    write_request(RunRequest(procedure=CaseProcedure()), folder)
    cell.journal.write(Entry.OPENED, 0.0, theatre="a test", banner="", strategy="ocs", seed=None)
    engine = cell.engine(plain_order("T1"))
    engine.run_to(engine.order.find("fit:T1"))
    engine.run_step(engine.order.find("localization:T1"))
    engine.run_to()
    engine.close("done")
    seal_run(folder)
    return folder
