"""A plan editor with nothing drawn yet."""

from __future__ import annotations

from pathlib import Path

import pytest
from plan_editors import draw, save, scan

from console.planning.plan_editor import PlanEditor


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "plan.toml"


@pytest.fixture
def editor(file: Path) -> PlanEditor:
    return PlanEditor(scan(), file, None)


@pytest.fixture
def saved(editor: PlanEditor) -> PlanEditor:
    """With a plan drawn and saved."""
    draw(editor)
    save(editor)
    return editor
