from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tomli_w
from coded_errors import raises

from drivers.kuka_rsi.options import read_options
from procedures.workcell.errors import AnotherArm
from procedures.workcell.tools import require_this_arm
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.calibrated_arm.error_budget import ErrorSizes
from ronna_hw.calibration import CalibrationExpired
from ronna_hw.config import (
    BadTheatreFile,
    Calibrations,
    ProcedureSettings,
    parse_theatre,
    read_theatre_file,
)
from ronna_hw.errors import ConfigurationError
from ronna_hw.roles import ASSISTANT
from ronna_hw.wire.polaris import PolarisModel
from sim.errors import BAD_CALIBRATION_FILE
from sim.kuka.controller_parameters import ControllerParameters
from sim.theatre.launch import CALIBRATION_FILE, read_calibrations
from sim.theatre.theatre_file import theatre_content, write_theatre_file
from sim.world.options import ArmRole
from sim.world.process import load_scene
from sim.world.rigid import inverse, matrix_of
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import add_patient_frame, draw_scene

ENDPOINTS = {
    "polaris": "serial:///dev/pts/9",
    "kuka": {
        "rsi": "udp://127.0.0.1:59152",
        "eki": "tcp://127.0.0.1:54600",
        "eki_project": "tcp://127.0.0.1:54602",
    },
    "basler": {"left": "gev://127.77.0.1", "right": "gev://127.77.0.2"},
}


def _written(scene: Scene, folder: Path) -> Path:
    path = folder / "theatre.toml"
    write_theatre_file(
        theatre_content(scene, ENDPOINTS, "host:", {"robot_frame": "robot_frame.rom"}, 2.0), path
    )
    return path


def _records(scene: Scene, folder: Path) -> Calibrations:
    calibration = read_theatre_file(_written(scene, folder)).calibration
    assert calibration is not None
    return calibration


@pytest.mark.parametrize("arm", [ArmChoice.UR5, ArmChoice.UR5E])
def test_the_file_of_another_arm_names_its_driver_its_addresses_and_its_model(
    arm: ArmChoice, tmp_path: Path
) -> None:
    addresses = {"rtde": "tcp://127.0.0.9:30004", "dashboard": "tcp://127.0.0.9:29999"}
    addresses |= {"primary": "tcp://127.0.0.9:30001"}
    endpoints = ENDPOINTS | {"ur": {**addresses, "realtime": "tcp://127.0.0.9:30003"}}
    path = tmp_path / "theatre.toml"
    write_theatre_file(theatre_content(draw_scene("mini", arm=arm), endpoints, "host:", {}, 2.0), path)
    robot = read_theatre_file(path).robot["master"]
    assert (robot.driver, robot.options["model"]) == ("universal_robots", arm)
    assert robot.endpoints == addresses


def test_a_force_that_an_arm_senses_by_itself_is_stated_with_an_error_that_a_scene_can_change() -> None:
    scene = load_scene("mini", seed=4, dual=True, assistant_arm=ArmChoice.UR5E)
    of_assistant = {"rtde": "tcp://127.0.0.9:30004", "dashboard": "tcp://127.0.0.9:29999"}
    of_assistant["primary"] = "tcp://127.0.0.9:30001"
    endpoints: dict[str, Any] = {**ENDPOINTS, "assistant": of_assistant}

    def stated_N(scene: Scene) -> object:
        file = parse_theatre(theatre_content(scene, endpoints, "host:", {}, 2.0))
        return file.robot["assistant"].options["force_error_N"]

    assert stated_N(scene) == 3.5
    assert scene.assistant is not None
    measured = scene.assistant.model_copy(update={"force_error_N": 0.8})
    assert stated_N(scene.model_copy(update={"assistant": measured})) == 0.8


def test_the_written_theatre_file_is_valid(tmp_path: Path) -> None:
    theatre = read_theatre_file(_written(draw_scene("mini", seed=4), tmp_path))
    assert theatre.banner
    assert theatre.calibration is not None


def test_calibration_records_are_truth_plus_an_error_of_the_stated_size(tmp_path: Path) -> None:
    found, angles_rad = [], []
    for seed in range(30):
        scene = draw_scene("mini", seed=seed)
        record = _records(scene, tmp_path)
        tip = np.subtract(
            record.tool_tip.flange_from_tool.translation_mm,
            scene.mount.flange_from_tool_nominal.translation_mm,
        )
        found.append(float(tip @ tip))
        angles_rad.append(2.0 * np.arccos(min(1.0, record.tool_tip.flange_from_tool.quaternion_wxyz[0])))
        assert not np.allclose(tip, 0.0)
        assert 0.7 < np.sqrt(np.mean(found)) / record.tool_tip.stated_error_mm < 1.3
    assert 0.7 < np.sqrt(np.mean(np.square(angles_rad))) / record.tool_tip.stated_direction_error_rad < 1.3


def test_the_record_of_the_head_holds_the_nominal_mount_not_the_true_one(tmp_path: Path) -> None:
    scene = draw_scene("mini", seed=4)
    record = _records(scene, tmp_path)
    assert record.stereo_head.flange_from_tool == scene.mount.flange_from_tool_nominal
    assert record.stereo_head.flange_from_tool != scene.mount.flange_from_tool_true


def test_a_camera_record_is_within_a_tenth_of_a_millimetre_of_the_truth(tmp_path: Path) -> None:
    scene = draw_scene("mini", seed=4)
    record = _records(scene, tmp_path)
    true = matrix_of(scene.left.camera_from_tool)
    stated = matrix_of(record.stereo_head.left.camera_from_tool)
    shift = (inverse(true) @ stated)[:3, 3]
    assert 0.0 < float(np.linalg.norm(shift)) < 0.1


def test_a_calibrated_arm_has_a_record_with_a_small_residual_error(tmp_path: Path) -> None:
    scene = load_scene("mini", seed=4, calibrated=True)
    record = _records(scene, tmp_path)
    assert record.arm is not None
    off = np.subtract(record.arm.joint_offset_rad, scene.arm.joint_offset_rad)
    assert 0.0 < np.abs(off).max() < 6e-4
    head = np.subtract(
        record.stereo_head.flange_from_tool.translation_mm, scene.mount.flange_from_tool_true.translation_mm
    )
    assert 0.0 < np.abs(head).max() < 0.5
    assert load_scene("mini", seed=4).calibration_error.arm is None
    sizes = ErrorSizes.stated(ProcedureSettings(), record.arm)
    assert (sizes.tool_mm, sizes.links) == pytest.approx((0.1, 0.16))


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_calibration_with_a_non_finite_number_is_refused(value: float) -> None:
    content = theatre_content(draw_scene("mini"), ENDPOINTS, "host:", {"robot_frame": "robot_frame.rom"}, 2.0)
    head = content["calibration"]["stereo_head"]
    head["flange_from_tool"]["translation_mm"] = [value, 0.0, 0.0]
    with pytest.raises(ConfigurationError, match=r"CFG-001: .*flange_from_tool.translation_mm 1"):
        parse_theatre(content)


def test_another_cycle_time_is_passed_to_the_robot_driver() -> None:
    scene = draw_scene("mini")
    for cycle_ms, said in ((12, 12), (None, None)):
        theatre = parse_theatre(theatre_content(scene, ENDPOINTS, "host:", {}, 2.0, cycle_ms=cycle_ms))
        assert read_options("robot.master", theatre.robot["master"].options).cycle_ms == said


def framed_theatre(**settings: str) -> dict[str, Any]:
    """The theatre of a scene with the patient's frame."""
    content = theatre_content(add_patient_frame(draw_scene("mini", seed=4)), ENDPOINTS, "host:", {}, 1.0)
    return {**content, "procedure": {**content["procedure"], **settings}}


def test_the_theatre_of_another_tracker_names_its_model() -> None:
    scene = draw_scene("mini")
    vega = scene.tracker.model_copy(update={"model": PolarisModel.VEGA})
    content = theatre_content(scene.model_copy(update={"tracker": vega}), ENDPOINTS, "host:", {}, 1.0)
    assert content["tracker"]["options"]["expected_model"] == "vega"
    assert "expected_model" not in theatre_content(scene, ENDPOINTS, "host:", {}, 1.0)["tracker"]["options"]


def test_the_theatre_names_the_patients_frame_only_where_there_is_one() -> None:
    plain = theatre_content(draw_scene("mini", seed=4), ENDPOINTS, "host:", {}, 1.0)
    assert parse_theatre(plain).procedure.patient_frame is None
    assert parse_theatre(framed_theatre()).procedure.patient_frame == "patient_frame"


@pytest.mark.parametrize(
    ("name", "key"),
    [("robot_frame", "calibration.tracker_frame.tool"), ("guide_frame", "tools.guide.frame.tool")],
)
def test_a_patients_frame_that_is_one_on_the_arm_is_refused(name: str, key: str) -> None:
    with pytest.raises(BadTheatreFile, match=f"CFG-001.*{name} is also {key}, a frame on the arm: name the"):
        parse_theatre(framed_theatre(patient_frame=name))


def test_on_the_first_day_the_frame_and_tip_records_are_as_drawn_and_expired() -> None:
    scene = load_scene("mini", seed=4, first_day=True)
    usual = parse_theatre(
        theatre_content(load_scene("mini", seed=4), ENDPOINTS, "host:", {}, 1.0)
    ).calibration
    drawn = parse_theatre(theatre_content(scene, ENDPOINTS, "host:", {}, 1.0)).calibration
    assert usual is not None
    assert drawn is not None
    now = datetime.now(UTC)
    for record in (drawn.tool_tip, drawn.tracker_frame):
        with pytest.raises(CalibrationExpired):
            record.check_valid_at(now)
    drawn.stereo_head.check_valid_at(now)
    assert drawn.stereo_head.left == usual.stereo_head.left
    assert drawn.tracker_frame.stated_error_mm > usual.tracker_frame.stated_error_mm


def test_later_calibration_files_override_earlier_ones(tmp_path: Path) -> None:
    for name, content in (("one", {"arm": 1, "tool_tip": 1}), ("other", {"tool_tip": 2})):
        (tmp_path / name).mkdir()
        (tmp_path / name / CALIBRATION_FILE).write_text(tomli_w.dumps({"calibration": content}))
    found = read_calibrations([tmp_path / "one", tmp_path / "other" / CALIBRATION_FILE])
    assert found == {"arm": 1, "tool_tip": 2}


@pytest.mark.parametrize("text", [None, "x = 1", "calibration = 3", "[calibration]"])
def test_a_calibration_file_without_records_is_refused(tmp_path: Path, text: str | None) -> None:
    if text is not None:
        (tmp_path / CALIBRATION_FILE).write_text(text)
    with raises(BAD_CALIBRATION_FILE, match="SIM-014"):
        read_calibrations([tmp_path])


def test_a_port_out_of_range_is_reported_with_its_key_and_a_fitting_example() -> None:
    endpoints = {"rsi": "udp://192.168.10.20:59152", "eki": "tcp://127.0.0.1:70000"}
    content = {"theatre": "lab", "robot": {"master": {"driver": "kuka_rsi", "endpoints": endpoints}}}
    with pytest.raises(BadTheatreFile, match=r"robot\.master\.endpoints\.eki: CFG-002") as refused:
        parse_theatre(content)
    assert "tcp://" in refused.value.what
    assert "serial://" not in refused.value.what


def test_the_records_of_two_arms_name_the_serial_numbers_that_their_controllers_report() -> None:
    scene = load_scene("mini", seed=4, calibrated=True, dual=True)
    of_assistant = {"rsi": "udp://127.0.0.1:59153", "eki": "tcp://127.0.0.1:54700"}
    of_assistant["eki_project"] = "tcp://127.0.0.1:54702"
    endpoints: dict[str, Any] = {**ENDPOINTS, "assistant": of_assistant}
    records = parse_theatre(theatre_content(scene, endpoints, "host:", {}, 2.0)).calibration
    assert records is not None
    serials = [str(ControllerParameters.parse(()).of_arm(role.number).serial_number) for role in ArmRole]
    assert [one and one.serial for one in (records.arm, records.assistant_arm)] == serials
    with pytest.raises(AnotherArm, match="CAL-013"):  # as if they were exchanged
        require_this_arm(records.arms, serials[0], ASSISTANT)
