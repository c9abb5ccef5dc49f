"""The tool on a calibrated arm: corrected poses, and refusal of another arm's record."""

from __future__ import annotations

import math
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from arm_looks import ENDPOINTS
from coded_errors import raises
from recording_cell import RecordingCell, theatre_of

from procedures.workcell.errors import SAME_ARM_TWICE, AnotherArm
from procedures.workcell.tools import calibrated_arm, require_this_arm, require_two_arms
from ronna_hw.arm.clearance.bodies import Capsule, Obstacle, Surroundings
from ronna_hw.arm.kr6_r900 import R900_2, SIXX, kr6_r900
from ronna_hw.calibration import ArmCalibration
from ronna_hw.config import parse_theatre
from ronna_hw.frames import Frame
from ronna_hw.roles import ASSISTANT, MASTER
from sim.theatre.theatre_file import theatre_content
from sim.world.process import load_scene


def _records():  # of a calibrated theatre
    scene = load_scene("mini", seed=3, calibrated=True)
    calibrations = parse_theatre(theatre_content(scene, ENDPOINTS, "host:", {}, 1.0)).calibration
    assert calibrations is not None
    return calibrations


def test_the_record_of_another_arm_is_refused() -> None:
    with pytest.raises(AnotherArm, match="CAL-013"):
        calibrated_arm(kr6_r900(R900_2), _records().arms)


@pytest.mark.parametrize(
    ("recorded", "reported", "refused"),
    [("1", "1", False), ("1", "2", True), (None, "2", False), ("1", "", False)],
)
def test_the_record_of_another_arm_of_the_model_is_refused_where_both_have_a_serial_number(
    recorded: str | None, reported: str, refused: bool
) -> None:
    record = _records().arm.model_copy(update={"serial": recorded})
    expected = pytest.raises(AnotherArm, match="expected 2, got 1") if refused else nullcontext()
    with expected:
        require_this_arm({MASTER: record}, reported)


@pytest.mark.parametrize(
    ("other", "advice"),
    [
        ("2", "Exchange [calibration.arm] and [calibration.assistant_arm]"),
        ("3", "Name this arm's own record in [calibration.assistant_arm]"),
    ],
)
def test_the_advice_on_a_record_of_the_assistant_leaves_that_of_the_master_alone(
    other: str, advice: str
) -> None:
    of_assistant, of_master = (
        cast("ArmCalibration", SimpleNamespace(identifier="one", serial=serial)) for serial in ("1", other)
    )
    with pytest.raises(AnotherArm) as refused:
        require_this_arm({MASTER: of_master, ASSISTANT: of_assistant}, "2", ASSISTANT)
    assert advice in refused.value.advice
    assert ("swapped" in refused.value.what) is (other == "2")


def test_one_arm_does_not_play_both_roles() -> None:
    require_two_arms(("KR 6 R900 sixx", "601234"), ("KR 6 R900 sixx", "601235"))
    require_two_arms(("KR 6 R900 sixx", "7"), ("UR5e", "7"))  # each maker counts its own
    require_two_arms(("KR 6 R900 sixx", ""), ("KR 6 R900 sixx", ""))  # unreported
    with raises(SAME_ARM_TWICE, match="DUAL-004"):
        require_two_arms(("KR 6 R900 sixx", "601234"), ("KR 6 R900 sixx", "601234"))


def test_the_pose_sent_to_the_controller_is_corrected_by_the_calibration_of_the_arm_if_it_has_one() -> None:
    kinematics, records = kr6_r900(SIXX), _records()
    flange_from_tool = records.stereo_head.flange_from_tool.transform(Frame.FLANGE, Frame.TOOL)
    arm, plain = (calibrated_arm(kinematics, of) for of in (records.arms, {}))
    wanted = arm.flange_pose(kinematics.home_rad) @ flange_from_tool
    joints = arm.compensate(wanted @ flange_from_tool.inverse(), kinematics.home_rad).joints_rad
    commanded = arm.pose_to_command(wanted, flange_from_tool, lambda: kinematics.home_rad)
    np.testing.assert_allclose(joints, kinematics.home_rad, atol=1e-7)
    by_controller = kinematics.flange_pose(joints) @ flange_from_tool
    np.testing.assert_allclose(commanded.translation_mm, by_controller.translation_mm, atol=1e-4)
    assert np.linalg.norm(commanded.translation_mm - wanted.translation_mm) > 0.3
    wanted = plain.flange_pose(kinematics.home_rad) @ flange_from_tool
    assert plain.pose_to_command(wanted, flange_from_tool, lambda: kinematics.home_rad) is wanted


def test_the_surroundings_are_exact_where_a_calibrated_arm_works(tmp_path: Path) -> None:
    """Between home and head the deviations of this arm differ by 0.4 mm, of others by 1.5 mm."""
    cell = RecordingCell(tmp_path, theatre=theatre_of(load_scene("mini", seed=3, calibrated=True)))
    arm, there = calibrated_arm(cell.arm.kinematics, cell.calibrations.arms), (0.1, -0.8, 1.8, -0.3, 0.5, 3.4)
    touched_mm = arm.forward(there).position_mm
    room = Surroundings(obstacles=(Obstacle("ball", Capsule(touched_mm, touched_mm, 5.0)),))
    seen_mm = []
    for near_rad in (there, None):
        cell.workcell.master.surround(room, near_rad)
        assert cell.workcell.master.surroundings is not None
        seen_mm.append(cell.workcell.master.surroundings.obstacles[0].capsule.start_mm)
    np.testing.assert_allclose(seen_mm[0], arm.nominal.forward(there).position_mm, atol=1e-9)
    assert math.dist(*seen_mm) > 0.3
