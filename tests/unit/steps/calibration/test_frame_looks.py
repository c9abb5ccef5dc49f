"""The reference frame is turned in view of the tracker only when confirmed and from reachable poses."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from clinical_case import ClinicalCell
from coded_errors import raises
from prepared_results import checked_set_up
from recording_cell import RecordingOperator

from procedures.calibration.errors import POSES_OUT_OF_REACH
from procedures.calibration.frame_calibration import FrameLooks, Use, calibrate_frame
from procedures.journal.errors import GateFailed, StepRefused
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Topic
from procedures.steps.calibration import frame_looks
from procedures.steps.calibration.frame_looks import rotation_step
from procedures.workcell import MountedTool, tracker_look
from ronna_hw.devices.readings import TrackerFrame
from ronna_hw.frames import Transform

COUNT, VALIDATION = 15, 5


def turned(cell: ClinicalCell) -> FrameLooks:
    cell.carrying(MountedTool.STEREO_HEAD)
    return cell.run(checked_set_up(cell), rotation_step(COUNT, VALIDATION)).result.observed


def test_the_measurements_recover_the_reference_frame_of_the_cell(cell: ClinicalCell) -> None:
    observed = turned(cell)
    uses = [one.use for one in observed.looks]
    assert (uses.count(Use.FIT), uses.count(Use.VALIDATION)) == (COUNT, VALIDATION)
    assert uses[0] is uses[-1] is Use.RETURN
    result = calibrate_frame(observed)
    assert result.change_mm < 1e-6
    assert observed.created > datetime.now(UTC) - timedelta(minutes=1)


def test_the_arm_does_not_move_without_confirmation(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.CALIBRATION)
    with pytest.raises(NotConfirmed, match="The arm will rotate the frame robot_frame"):
        turned(cell)
    assert cell.arm.motions == []


def test_a_reference_frame_out_of_view_fails_the_gate(cell: ClinicalCell) -> None:
    theatre = cell.calibrations.tracker_frame
    cell.tracker.hidden = True
    with pytest.raises(GateFailed, match=f"the reference frame {theatre.tool} is in 0 of"):
        turned(cell)


def test_poses_without_a_view_of_the_frame_are_told_from_outliers(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = tracker_look.average_pose
    looks = iter(range(100))

    def hidden_twice(frames: list[TrackerFrame], tool: str) -> Transform:
        if next(looks) in (2, 3):
            raise GateFailed(f"the reference frame {tool} is in 0 of 60 frames")
        return seen(frames, tool)

    monkeypatch.setattr(frame_looks, "average_pose", hidden_twice)
    cell.carrying(MountedTool.STEREO_HEAD)
    done = cell.run(checked_set_up(cell), rotation_step(COUNT, VALIDATION)).result
    tool = cell.calibrations.tracker_frame.tool
    assert done.remarks == (f"2 of 22 poses not measured: 2 x the reference frame {tool} not in view",)


def test_an_arm_that_cannot_turn_from_its_pose_is_refused_before_the_operator_is_asked(
    cell: ClinicalCell,
) -> None:
    cell.arm.joints_rad = (0.0, 0.0, 0.0, 0.0, 0.3, 0.0)  # stretched out
    with raises(POSES_OUT_OF_REACH, match="CAL-010"):
        turned(cell)
    assert cell.operator.asked == []


@pytest.mark.hazard(37)
def test_the_frame_is_not_calibrated_with_the_guide_mounted(cell: ClinicalCell) -> None:
    cell.carrying(MountedTool.GUIDE)
    with pytest.raises(StepRefused, match="the arm carries the guide"):
        cell.run(checked_set_up(cell), rotation_step(COUNT, VALIDATION))
