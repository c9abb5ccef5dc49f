"""Fixtures of several rooms."""

from pathlib import Path

import pytest
from recording_cell import RecordingCell


@pytest.fixture
def cell(tmp_path: Path) -> RecordingCell:
    return RecordingCell(tmp_path)
