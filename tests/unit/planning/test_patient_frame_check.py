"""The patient's frame and the one on the assistant's holder must each be a tracked tool of its own."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest
from clinical_case import ClinicalCell
from coded_errors import raises

from procedures.planning.errors import PATIENT_FRAME_UNFIT
from procedures.planning.tool_records import ToolRecords, check_patient_frame
from ronna_hw.config import HOLDER_FRAME, require_own_frames
from ronna_hw.devices.errors import UnknownTool
from ronna_hw.patient_frame import MARKERS_MM, NAME
from ronna_hw.x_frame import SPHERE_CENTRES_MM
from sim.world.scene.named_scenes import ROBOT_FRAME_MARKERS_MM

TOOLS = {"robot_frame": ROBOT_FRAME_MARKERS_MM}


@pytest.fixture
def cell(tmp_path: Path) -> ClinicalCell:
    return ClinicalCell(tmp_path)


def test_a_frame_of_its_own_is_accepted(cell: ClinicalCell) -> None:
    check_patient_frame(NAME, cell.calibrations, {**TOOLS, NAME: MARKERS_MM})


def test_a_frame_that_the_tracker_does_not_know_is_refused(cell: ClinicalCell) -> None:
    with pytest.raises(UnknownTool, match=r"DEV-003: .*names patient_frame.*expected robot"):
        check_patient_frame(NAME, cell.calibrations, TOOLS)


@pytest.mark.parametrize(
    ("markers_mm", "whose"),
    [
        (ROBOT_FRAME_MARKERS_MM[::-1], "robot_frame"),
        ([(x + 50.0, y, z) for x, y, z in ROBOT_FRAME_MARKERS_MM], "robot_frame"),
        (SPHERE_CENTRES_MM, "the x-shaped frame on the skull"),
    ],
    ids=["the arm's, in another order", "the arm's, about another origin", "the skull's"],
)
def test_a_frame_with_the_shape_of_another_is_refused(
    cell: ClinicalCell, markers_mm: list[tuple[float, float, float]], whose: str
) -> None:
    with raises(PATIENT_FRAME_UNFIT, match=rf"TOOL-008.*{whose}.*limit 2 mm.*got 0\.00 mm.*shipped one"):
        check_patient_frame(NAME, cell.calibrations, {**TOOLS, NAME: markers_mm})


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
