"""The tracker checks the frame on the guide before the guide moves; a wrong tool is never moved."""

from __future__ import annotations

from pathlib import Path

import pytest
from clinical_case import ClinicalCell
from prepared_results import checked_plan, coarse, localized_fiducials, mounted_guide

from procedures.steps.clinical.tool_check import STEP, CheckedTool
from procedures.steps.errors import ToolSeenElsewhere
from procedures.workcell import MountedTool
from ronna_hw.calibration import Numbers3


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path / "run").carrying(MountedTool.GUIDE)


def check(cell: ClinicalCell, off_mm: Numbers3 | None) -> CheckedTool:
    cell.tracker.guide_shift_mm = off_mm
    cell.run(mounted_guide(), *coarse(), checked_plan(), localized_fiducials(), STEP)
    return cell.case.get(CheckedTool).result


@pytest.mark.hazard(47)
def test_a_guide_seen_near_its_recorded_place_continues_to_the_gauge(cell: ClinicalCell) -> None:
    assert check(cell, (0.0, 0.6, 0.0)).seen_off_mm == pytest.approx(0.6, abs=1e-3)


@pytest.mark.hazard(47)
@pytest.mark.parametrize(
    "off_mm", [(0.0, 0.0, 1.2), (0.0, 2.0, 0.0), None], ids=["elsewhere", "shifted by 2 mm", "another tool"]
)
def test_a_tool_seen_off_its_place_or_not_at_all_is_not_moved(
    cell: ClinicalCell, off_mm: Numbers3 | None
) -> None:
    with pytest.raises(ToolSeenElsewhere, match=r"TOOL-006: the tracker (sees|does not see) guide_frame"):
        check(cell, off_mm)
    assert cell.arm.motions == []
