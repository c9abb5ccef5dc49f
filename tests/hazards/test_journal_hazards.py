"""Hazard 33: no journal, no motion."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, cast

import pytest

from procedures.engine.case import Case
from procedures.engine.engine import Engine
from procedures.engine.errors import JournalNotWritable
from procedures.engine.journal import Journal
from procedures.engine.step import Outcome, StepContext, StepSpec
from ronna_hw.clock import HostClock

FULL_DISK = "/dev/full"


class Arm:
    """Counts what it is told."""

    def __init__(self) -> None:
        self.motions = self.stops = 0

    def stop(self) -> None:
        self.stops += 1


class Nobody:
    """No step may even be announced."""

    def announce(self, step: str) -> None:
        raise AssertionError(f"{step} was announced")


@pytest.fixture
def arm() -> Arm:
    return Arm()


@pytest.fixture
def engine(arm: Arm, tmp_path: Path) -> Engine:
    def move(_context: StepContext) -> Outcome:
        arm.motions += 1
        return Outcome({})

    return Engine(
        steps={"ct_import": StepSpec("ct_import", "", (), move, moves=True)},
        trajectories=(),
        case=Case(tmp_path, tmp_path, tmp_path),
        theatre=cast("Any", type("Theatre", (), {"calibration": object(), "procedure": None})()),
        devices=cast("Any", arm),
        clock=HostClock(),
        operator=cast("Any", Nobody()),
        journal=Journal(tmp_path),
    )


@pytest.mark.hazard(33)
def test_a_step_whose_intent_cannot_be_written_moves_nothing(engine: Engine, arm: Arm) -> None:
    os.dup2(full := os.open(FULL_DISK, os.O_WRONLY), engine.journal._file)
    os.close(full)
    with pytest.raises(JournalNotWritable, match=r"PRO-003.*No space left"):
        engine.run_step(engine.find("ct_import"))
    assert arm.motions == 0
    assert engine.finished == ()
    engine.journal.close()


@pytest.mark.hazard(33)
def test_a_folder_that_cannot_be_written_gives_no_journal_and_so_no_engine(tmp_path: Path) -> None:
    with pytest.raises(JournalNotWritable, match="PRO-003"):
        Journal(tmp_path / "missing")
