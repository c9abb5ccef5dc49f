"""`ronna-plan check` as a user runs it: outputs, exit codes, one line per error."""

from __future__ import annotations

import json
import resource
import subprocess
from pathlib import Path

import numpy as np
import pytest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian
from user_commands import in_this_process

from procedures.cli.plan import app

SERIES = "1.2.826.0.1.3680043.8.498.77"
PLAN = f"""
schema = 1
series_instance_uid = "{SERIES}"
patient_orientation = "HFS"
implanted = 4
fiducials = "free"
tool = "guide"

[[trajectories]]
id = "T1"
entry_mm = [10.0, -50.0, 60.0]
target_mm = [5.0, -20.0, 20.0]
free_angle_deg = 0.0
margin_mm = 1.5
"""
HEAD_MM = 79.0
NEAR, FAR = ("700", "0", "100", "-90", "0", "-90"), ("1500", "0", "250", "-90", "0", "-90")
POSE = {"translation_mm": [220.0, 0.0, 60.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
CAMERA = {
    "serial": "1",
    "focal_px": [9000.0, 9000.0],
    "principal_point_px": [1023.5, 543.5],
    "camera_from_tool": {"translation_mm": [0.0, 0.0, 250.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]},
}


@pytest.fixture
def case(tmp_path: Path) -> tuple[Path, Path]:
    """A plan file and a coarse CT around it: 61 slices of 20 x 20 voxels of 10 mm, 3 mm apart.

    The head is a ball; the entry lies on it.
    """
    (tmp_path / "plan.toml").write_text(PLAN)
    series = tmp_path / "series"
    series.mkdir()
    grid_mm = np.arange(-95.0, 100.0, 10.0)
    for number in range(61):
        in_tissue = np.hypot(grid_mm[:, None], grid_mm) ** 2 + (-90.0 + 3.0 * number) ** 2 < HEAD_MM**2
        data = Dataset()
        data.file_meta, data.preamble = FileMetaDataset(), b"\0" * 128
        data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        data.SOPClassUID = data.file_meta.MediaStorageSOPClassUID = CTImageStorage
        data.SOPInstanceUID = data.file_meta.MediaStorageSOPInstanceUID = f"{SERIES}.{number + 1}"
        data.SeriesInstanceUID, data.StudyInstanceUID = SERIES, f"{SERIES}.0"
        data.FrameOfReferenceUID = f"{SERIES}.99"
        data.Modality, data.PatientPosition = "CT", "HFS"
        data.PatientName, data.PatientID = "Secret^Name", "SECRET-ID"
        data.InstanceNumber = number + 1
        data.ImagePositionPatient = ["-95", "-95", str(-90.0 + 3.0 * number)]
        data.ImageOrientationPatient = ["1", "0", "0", "0", "1", "0"]
        data.PixelSpacing, data.SliceThickness = ["10", "10"], "3"
        data.RescaleSlope, data.RescaleIntercept = "1", "-1024"
        data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
        data.Rows = data.Columns = 20
        data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 1
        data.PixelData = np.broadcast_to(np.where(in_tissue, 1064, 24), (20, 20)).astype("<i2").tobytes()
        data.save_as(series / f"{number:03d}.dcm", enforce_file_format=True)
    return tmp_path / "plan.toml", series


@pytest.fixture
def theatre(tmp_path: Path) -> Path:
    """A theatre file with an arm and calibrations, as TOML inline tables."""

    def table(value: object) -> str:
        if isinstance(value, dict):
            return "{" + ", ".join(f"{key} = {table(item)}" for key, item in value.items()) + "}"
        return str(value) if str(value).startswith("20") else json.dumps(value)

    dated = {"created": "2030-01-01T00:00:00Z", "expires": "2030-02-01T00:00:00Z", "made_by": "test"}
    record = {"identifier": "r", **dated, "stated_error_mm": 0.05}
    calibration = {
        "stereo_head": {**record, "flange_from_tool": POSE, "left": CAMERA, "right": CAMERA},
        "tool_tip": {**record, "tool_number": 2, "flange_from_tool": POSE},
        "tracker_frame": {**record, "tool": "M", "tool_from_marker": POSE},
    }
    path = tmp_path / "theatre.toml"
    endpoints = {"rsi": "udp://127.0.0.1:59152", "eki_project": "tcp://127.0.0.1:54602"}
    robot = {"driver": "kuka_rsi", "endpoints": endpoints, "options": {"variant": "kr6_r900_sixx"}}
    path.write_text(
        f'schema = 1\ntheatre = "test"\n'
        f"robot = {{master = {table(robot)}}}\ncalibration = {table(calibration)}\n"
    )
    return path


def ronna_plan(*arguments: object) -> subprocess.CompletedProcess[str]:
    return in_this_process(app, *arguments)


def one_line(done: subprocess.CompletedProcess[str]) -> str:
    """The error: the only line of standard error that is no warning."""
    lines = [line for line in done.stderr.splitlines() if not line.startswith("warning:")]
    assert len(lines) == 1, done.stderr
    assert "Traceback" not in done.stderr
    return lines[0]


def test_a_good_plan_is_accepted_with_a_table(case):
    done = ronna_plan("check", case[0], "--ct", case[1])
    assert done.returncode == 0, done.stderr
    assert "T1" in done.stdout
    assert "50.2" in done.stdout  # depth in mm
    assert "Secret" not in done.stdout + done.stderr


def test_json_is_one_object_on_standard_output(case):
    done = ronna_plan("check", case[0], "--ct", case[1], "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["passed"] is True
    assert document["trajectories"] == [{"id": "T1", "depth_mm": 50.249, "margin_mm": 1.5}]
    assert document["findings"] == document["warnings"] == []


@pytest.mark.hazard(9)
def test_a_plan_for_another_series_names_both(case):
    case[0].write_text(PLAN.replace(SERIES, "1.2.3.4"))
    done = ronna_plan("check", case[0], "--ct", case[1], "--json")
    assert done.returncode == 1
    assert one_line(done).startswith("PLAN-003")
    assert SERIES in done.stderr
    assert "1.2.3.4" in done.stderr
    assert json.loads(done.stdout)["findings"][0]["code"] == "PLAN-003"


def test_a_point_outside_the_ct_is_named(case):
    case[0].write_text(PLAN.replace("entry_mm = [10.0, -50.0, 60.0]", "entry_mm = [10, -50, 110]"))
    done = ronna_plan("check", case[0], "--ct", case[1])
    assert done.returncode == 1
    assert one_line(done).startswith("PLAN-006")
    assert "entry of trajectory T1" in done.stderr


def test_three_mistakes_of_a_plan_come_at_once(case):
    text = PLAN.replace("implanted = 4", "implanted = 12").replace('"HFS"', '"upright"')
    case[0].write_text(text.replace("margin_mm = 1.5", "margin = 1.5"))
    done = ronna_plan("check", case[0], "--ct", case[1])
    assert done.returncode == 1
    line = one_line(done)
    for part in ("PLAN-002", "implanted", "patient_orientation", "margin_mm", "margin"):
        assert part in line


def test_a_missing_plan_is_one_line(case):
    done = ronna_plan("check", case[0].with_name("absent.toml"), "--ct", case[1])
    assert done.returncode == 2
    assert one_line(done).startswith("PLAN-001")


def test_a_missing_series_is_one_line(case):
    done = ronna_plan("check", case[0], "--ct", case[1] / "absent")
    assert done.returncode == 1
    assert one_line(done).startswith("CT-001")


def test_markers_that_cannot_be_localized_are_the_localizers_error(case):
    done = ronna_plan("check", case[0], "--ct", case[1], "--markers")
    assert done.returncode != 0
    assert one_line(done).startswith("CT-")


def test_the_motions_of_the_arm_are_shown_before_anything_moves(case, theatre):
    done = ronna_plan("check", case[0], "--ct", case[1], "--config", theatre, "--robot-from-ct", *NEAR)
    assert done.returncode == 0, done.stderr
    header, *motions = done.stdout.splitlines()[-4:]
    for word in ("s", "smallest distance mm", "singularity", "A1..A6 deg"):
        assert word in header.split("\t")
    assert [motion.split("\t")[:3] for motion in motions] == [
        ["home", "T1/target", "move"],
        ["T1/target", "T1/target", "line"],
        ["T1/target", "home", "move"],
    ]


def test_every_motion_has_its_preview_in_json(case, theatre):
    done = ronna_plan(
        "check", case[0], "--ct", case[1], "--config", theatre, "--robot-from-ct", *NEAR, "--json"
    )
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert [(motion["from"], motion["to"]) for motion in document["motions"]] == [
        ("home", "T1/target"),
        ("T1/target", "T1/target"),
        ("T1/target", "home"),
    ]
    for motion in document["motions"]:
        assert motion["clear"]
        assert motion["duration_s"] > 0.5
        assert len(motion["joint_ranges_rad"]) == 6
        assert motion["closest"]["distance_mm"] >= 9.5  # the cell's margin, on a path of half a millimetre
        assert 0.0 < min(motion["singularity"].values()) <= 1.0
    assert document["free_angle_turns_rad"].keys() == {"T1"}


@pytest.mark.hazard(23)
def test_a_target_out_of_reach_is_refused_with_code_reason_and_action(case, theatre):
    done = ronna_plan("check", case[0], "--ct", case[1], "--config", theatre, "--robot-from-ct", *FAR)
    assert done.returncode == 3
    assert one_line(done).startswith("PLAN-007: T1/target: ")
    assert "ARM-001" in done.stderr
    assert "move the cart" in done.stderr


@pytest.mark.hazard(24)
def test_a_body_of_the_cell_in_the_way_is_refused_by_name(case, theatre):
    lamp = '\n[[cell.bodies]]\nname = "lamp"\nframe = "robot"\nradius_mm = 900.0\n'
    ends = "start_mm = [800.0, 0.0, 900.0]\nend_mm = [800.0, 0.0, 900.0]\n"
    theatre.write_text(theatre.read_text() + lamp + ends)
    done = ronna_plan(
        "check", case[0], "--ct", case[1], "--config", theatre, "--robot-from-ct", *NEAR, "--json"
    )
    assert done.returncode == 3
    assert "into the lamp" in one_line(done)
    finding = json.loads(done.stdout)["findings"][0]
    assert finding["code"] == "PLAN-007"
    assert finding["action"]
    assert json.loads(done.stdout)["motions"] == []


def test_a_head_beside_the_arm_at_home_is_warned_about(case, theatre):
    beside = ("640", "0", "250", "-90", "0", "-90")
    done = ronna_plan("check", case[0], "--ct", case[1], "--config", theatre, "--robot-from-ct", *beside)
    assert "warning: the upper arm is -45.0 mm from the torso at home already" in done.stderr


def test_a_home_outside_the_joint_ranges_is_refused(case, theatre):
    home = ("200", "-90", "90", "0", "60", "0")
    done = ronna_plan(
        "check", case[0], "--ct", case[1], "--config", theatre, "--robot-from-ct", *NEAR, "--home", *home
    )
    assert done.returncode != 0
    assert one_line(done).startswith("ARM-003: A1 would leave its range")


def test_the_motions_need_both_options(case, theatre):
    done = ronna_plan("check", case[0], "--ct", case[1], "--config", theatre)
    assert done.returncode == 2
    assert "--robot-from-ct" in one_line(done)


@pytest.mark.parametrize("value", ["nan", "inf"])
def test_a_place_of_the_head_that_is_no_number_is_a_usage_error(case, theatre, value):
    place = (value, "0", "250", "-90", "0", "-90")
    done = ronna_plan("check", case[0], "--ct", case[1], "--config", theatre, "--robot-from-ct", *place)
    assert done.returncode == 2
    assert one_line(done).startswith("CLI-001")
    assert "finite" in done.stderr


def test_exchanged_entry_and_target_are_refused(case):
    text = PLAN.replace("entry_mm", "x_mm").replace("target_mm", "entry_mm").replace("x_mm", "target_mm")
    case[0].write_text(text)
    done = ronna_plan("check", case[0], "--ct", case[1])
    assert done.returncode == 1
    assert one_line(done).startswith("PLAN-011")


def test_the_x_shaped_frame_is_not_there_yet(case):
    case[0].write_text(PLAN.replace('"free"', '"xframe"'))
    done = ronna_plan("check", case[0], "--ct", case[1])
    assert done.returncode == 2
    assert one_line(done).startswith("PLAN-013")


def test_help_costs_little_processor_time():
    spent = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert ronna_plan("check", "--help").returncode == 0
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
    assert min(spent) < 0.4
