"""A resumed case whose room and plan are as they were recorded."""

from __future__ import annotations

from pathlib import Path

import pytest
from clinical_case import ClinicalCell
from prepared_results import checked_plan

from procedures.runs import comparison, recovery
from procedures.workcell import MountedTool


@pytest.fixture(autouse=True)
def room_as_recorded(monkeypatch: pytest.MonkeyPatch) -> None:
    """The tracker has its own tests; here the comparison with the room finds what was recorded."""
    monkeypatch.setattr(recovery, "compare_room", lambda _engine, _comparison: True)


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path / "run").carrying(MountedTool.GUIDE)


@pytest.fixture(autouse=True)
def plan_as_checked(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(comparison, "read_plan", lambda _path: checked_plan().plan)
