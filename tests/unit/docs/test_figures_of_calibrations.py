"""The calibration pages explain figures under the names that the commands print."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
MODELS = ROOT / "procedures/reporting/calibration_figures.py"
EXPLAINED = re.compile(r"^- \*\*(.+?)\*\*", re.MULTILINE)


@pytest.mark.parametrize(
    "page", ["calibrate-tracker-frame", "calibrate-tool-tip", "stereo-calibration", "arm-calibration"]
)
def test_every_explained_figure_has_a_printed_name(page: str) -> None:
    text = (ROOT / f"docs/how-to/calibration/{page}.md").read_text(encoding="utf-8")
    section = text.partition("## What the figures mean")[2].partition("\n## ")[0]
    printed = MODELS.read_text(encoding="utf-8")
    named = EXPLAINED.findall(section)
    assert named
    assert [name for name in named if f'"{name}' not in printed] == []
