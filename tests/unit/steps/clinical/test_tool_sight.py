"""The tracker checks the frame on the guide before the guide moves; a wrong tool is never moved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from clinical_case import ClinicalCell, SeeingTracker, shifted
from guide_frames import with_guide_frame
from prepared_results import checked_plan, coarse, localized_fiducials, mounted_guide

from procedures.steps.clinical.tool_check import STEP, CheckedTool
from procedures.steps.errors import ToolSeenElsewhere
from procedures.workcell import MountedTool
from ronna_hw.calibration import Numbers3
from ronna_hw.devices.readings import ToolReading, TrackerFrame, Validity
from ronna_hw.frames import Frame
from ronna_hw.tool_record import ToolFrame
from sim.world.scene.guide_frame import MARKERS_MM, NAME
from sim.world.scene.named_scenes import named_scene

ON_TIP = with_guide_frame(named_scene("mini", seed=3)).mount.guide.tip_from_frame
assert ON_TIP is not None
FRAME = ToolFrame(tool=NAME, tip_from_frame=ON_TIP)


@dataclass
class SeesGuide(SeeingTracker):
    """Sees the frame on the guide as well, unless there is none, beside its place by `off_mm`."""

    off_mm: Numbers3 | None = (0.0, 0.0, 0.0)

    @property
    def markers_mm(self) -> dict[str, tuple[Numbers3, ...]]:
        return {**super().markers_mm, NAME: MARKERS_MM}

    def read_frame(self, timeout_s: float = 1.0) -> TrackerFrame:
        frame = super().read_frame(timeout_s)
        if self.off_mm is None:
            return replace(frame, tools=(*frame.tools, ToolReading(NAME, Validity.MISSING, None, None, None)))
        assert self.cell is not None
        workcell = self.cell.workcell
        on_tip = FRAME.tip_from_frame.transform(Frame.TOOL, Frame.MARKER)
        flange = self.cell.arm.kinematics.flange_pose(self.cell.arm.joints_rad)
        pose = shifted(flange @ workcell.flange_from(MountedTool.GUIDE) @ on_tip, self.off_mm)
        w, qx, qy, qz = pose.quaternion_wxyz.tolist()
        x, y, z = pose.translation_mm.tolist()
        seen = ToolReading(NAME, Validity.OK, (w, qx, qy, qz), (x, y, z), 0.1)
        return replace(frame, tools=(*frame.tools, seen))


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path / "run").carrying(MountedTool.GUIDE)


def check(cell: ClinicalCell, off_mm: Numbers3 | None) -> CheckedTool:
    tools = cell.workcell.tools
    guide = tools.guide.record.model_copy(update={"frame": FRAME})
    cell.workcell.tools = replace(tools, records={**tools.records, "guide": guide})
    cell.tracker = cell.opened.replace_tracker(SeesGuide("tracker", cell=cell, off_mm=off_mm))
    cell.tracker.state = cell.arm.state
    cell.run(mounted_guide(), *coarse(), checked_plan(), localized_fiducials(), STEP)
    return cell.case.get(CheckedTool).result


@pytest.mark.hazard(47)
def test_a_guide_seen_near_its_recorded_place_continues_to_the_gauge(cell: ClinicalCell) -> None:
    assert check(cell, (0.0, 0.6, 0.0)).seen_off_mm == pytest.approx(0.6, abs=1e-3)


@pytest.mark.hazard(47)
@pytest.mark.parametrize("off_mm", [(0.0, 0.0, 1.2), None], ids=["elsewhere", "unseen"])
def test_a_tool_seen_off_its_place_or_not_at_all_is_not_moved(
    cell: ClinicalCell, off_mm: Numbers3 | None
) -> None:
    with pytest.raises(ToolSeenElsewhere, match=r"TOOL-006: the tracker (sees|does not see) guide_frame"):
        check(cell, off_mm)
    assert cell.arm.motions == []
