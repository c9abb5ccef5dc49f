"""A planner's desk with nothing drawn yet."""

from __future__ import annotations

from pathlib import Path

import pytest
from plan_desks import scan

from console.planning.plan_editor import PlanDesk


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "plan.toml"


@pytest.fixture
def desk(file: Path) -> PlanDesk:
    return PlanDesk(scan(), file, None)
