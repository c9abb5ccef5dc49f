"""The frame on the assistant's holder is a tool of its own, which the tracker tracks."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from procedures.planning.tool_records import ToolRecords
from ronna_hw.config import HOLDER_FRAME, require_own_frames
from ronna_hw.devices.errors import UnknownTool


def with_holder(frame: str) -> Any:
    return SimpleNamespace(frames={"calibration.tracker_frame.tool": "robot", HOLDER_FRAME: frame})


def test_a_frame_that_is_none_of_the_trackers_tools_is_refused_with_their_names() -> None:
    with pytest.raises(UnknownTool, match=r"\[calibration.assistant_holder\] names cart.*robot or helper"):
        ToolRecords({}, "").check_frames(with_holder("cart"), ("robot", "helper"))


def test_a_frame_on_the_master_is_not_that_on_the_holder() -> None:
    procedure = SimpleNamespace(patient_frame=None)
    theatre = cast("Any", SimpleNamespace(calibration=with_holder("robot"), tools={}, procedure=procedure))
    with pytest.raises(ValueError, match=r"robot is also .*, a frame on the master"):
        require_own_frames(theatre)
