"""Frame and tip on the same mount stay together, whatever a calibration finds for the head."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np

from procedures.calibration.head_calibration import move_tip
from procedures.calibration.head_model import pose_record
from ronna_hw.calibration import PoseRecord, ToolTipCalibration, TrackerFrameCalibration
from ronna_hw.frames import Frame, Transform

NOW = datetime(2026, 1, 1, tzinfo=UTC)
DATES = {"created": NOW, "expires": NOW + timedelta(days=30), "made_by": "test", "stated_error_mm": 0.1}


def transform(target: Frame, source: Frame, *translation_mm: float, turned: float = 0.0) -> Transform:
    half = turned / 2.0
    return Transform.of(
        target,
        source,
        translation_mm=translation_mm,
        quaternion_wxyz=(float(np.cos(half)), 0.0, float(np.sin(half)), 0.0),
    )


def test_frame_and_tip_at_one_place_stay_together_when_the_head_is_found_elsewhere() -> None:
    before = transform(Frame.FLANGE, Frame.TOOL, 220.0, 0.0, 60.0)
    after = transform(Frame.FLANGE, Frame.TOOL, 221.5, -0.8, 61.0, turned=0.01)
    beside = transform(Frame.TOOL, Frame.MARKER, -150.0, 20.0, -140.0, turned=0.3)
    # The frame's record is beside the tool centre, so it needs no change; the tip's is on the flange.
    frame = TrackerFrameCalibration(
        identifier="frame", tool="frame", tool_from_marker=pose_record(beside), **DATES
    )
    place = before.rigid * beside.rigid
    tip = ToolTipCalibration(
        identifier="tip",
        tool_number=2,
        flange_from_tool=pose_record(Transform(Frame.FLANGE, Frame.TOOL, place)),
        **DATES,
    )
    moved = move_tip(tip, before, after).flange_from_tool
    kept = after @ frame.tool_from_marker.transform(Frame.TOOL, Frame.MARKER)
    np.testing.assert_allclose(moved.translation_mm, kept.translation_mm, atol=1e-9)
    np.testing.assert_allclose(_turn(moved), _turn(pose_record(kept)), atol=1e-9)


def _turn(pose: PoseRecord) -> tuple[float, ...]:
    return tuple(np.abs(pose.quaternion_wxyz))
