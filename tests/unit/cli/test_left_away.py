"""A new case is told of a run on the same theatre that left the arm away from its home."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from recording_cell import HOME, RecordingCell

from procedures.cli.case.left_away import left_away
from procedures.cli.case.request import CaseRequest
from procedures.cli.case.request_file import write_request
from procedures.engine.order import order_of
from procedures.journal.journal import Entry
from procedures.operator.errors import NotConfirmed
from procedures.operator.topic import Topic
from procedures.steps.clinical import set_up


def earlier(runs: Path, *whats: str, config: str = "theatre.toml") -> None:
    """A run that made these motions and was killed."""
    runs.mkdir(exist_ok=True)
    cell = RecordingCell(runs / "20260101T000000-abcd")
    write_request(CaseRequest(out=runs, config=runs / config, case=runs), cell.folder)
    for what in whats:
        cell.journal.write(Entry.MOTION, 0.0, what=what)
        cell.journal.write(Entry.MOVED, 0.0, joints_rad=list(HOME))
    cell.journal.close()


def told(runs: Path) -> str | None:
    request = CaseRequest(out=runs, config=runs / "theatre.toml", case=runs)
    return left_away(request, runs / "20260102T000000-abcd")


def test_the_run_that_left_the_arm_away_is_named_with_the_way_on(tmp_path: Path) -> None:
    earlier(tmp_path, "go")
    words = told(tmp_path)
    assert words is not None
    assert f"ronna-procedure home {tmp_path / '20260101T000000-abcd'}" in words


def test_a_run_that_brought_the_arm_home_or_was_elsewhere_says_nothing(tmp_path: Path) -> None:
    earlier(tmp_path / "home", "go", "home")
    earlier(tmp_path / "elsewhere", "go", config="another.toml")
    assert told(tmp_path / "home") is None
    assert told(tmp_path / "elsewhere") is None


@pytest.mark.hazard(5)
def test_such_a_position_becomes_home_only_when_it_is_confirmed(tmp_path: Path) -> None:
    cell = RecordingCell(tmp_path)
    cell.operator.refusing = (Topic.RESUME,)
    engine = cell.engine(order_of([set_up.STEP], ()))
    engine.setting = replace(engine.setting, left_away="run A left the arm away from its home")
    with pytest.raises(NotConfirmed, match="run A left the arm away"):
        engine.run_to()
    assert not cell.workcell.at_home
