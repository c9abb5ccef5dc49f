"""What an engine is made with, of the run that it resumes and of the theatre that it finds."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from plain_steps import plain_order
from recording_cell import RecordingArm, RecordingOperator, RecordingRoom, mini_theatre_file

from procedures.engine.engine import Engine
from procedures.engine.order import CaseOrder
from procedures.journal.journal import Entry, Journal
from procedures.runs.engine_setup import EngineInput, build_engine
from procedures.runs.interrupted_run import Resumption, read_interrupted_run


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


def resumed(run: Path, order: CaseOrder, stack: ExitStack, arm_not_home: str | None = None) -> Engine:
    """The engine of a run that was left, in a theatre at whose endpoints nothing is."""
    return build_engine(
        run,
        mini_theatre_file(run.parent, simulated=True),
        lambda _theatre: EngineInput(order),
        RecordingOperator(),
        RecordingRoom(RecordingArm("arm")),
        stack,
        Resumption(read_interrupted_run(run), accepted=True),
        on_ending=lambda: None,
        opening={},
        arm_not_home=arm_not_home,
    )


@pytest.mark.hazard(5)
def test_a_run_that_begins_over_is_warned_of_another_that_left_the_arm_away(
    tmp_path: Path, stack: ExitStack
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    Journal(run).close()
    engine = resumed(run, plain_order(), stack, arm_not_home="run B left the arm away")
    assert engine.setting.arm_not_home == "run B left the arm away"


@pytest.mark.hazard(2)
def test_an_arm_that_was_left_out_is_known_to_be_away_before_anything_is_compared(
    tmp_path: Path, stack: ExitStack
) -> None:
    run = tmp_path / "run"
    run.mkdir()
    journal = Journal(run)
    journal.write(Entry.MOTION, 0.0, what="go")
    journal.close()
    assert resumed(run, plain_order(), stack).setting.workcell.master.place.is_out
