"""`ronna-plan check` as a user runs it: outputs, exit codes, one line per error."""

from __future__ import annotations

import json
import socket
import subprocess
import sys
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import tomli_w
from fusion_records import fusion, write_fused_mr
from painted_ct import SERIES_UID as SERIES
from painted_ct import write_series
from plan_toml import PLAN, VESSEL
from user_commands import in_this_process

from console.planning.serving import PlannerRequest
from console.planning.serving import app as planner
from procedures.cli import planning_inputs
from procedures.cli.plan import app
from procedures.fusion.record import Fusion
from procedures.imaging import read_series
from procedures.planning.plan_file import read_plan
from ronna_hw.arm.pose import radians6
from ronna_hw.clock import HostClock
from ronna_hw.config import read_theatre_file
from ronna_hw.devices import JointMove
from ronna_hw.errors import EXIT_USAGE
from ronna_hw.marker_template import read_marker_template
from ronna_hw.registry import make_device

HEAD_MM = 79.0
NEAR, FAR = ("700", "0", "100", "-90", "0", "-90"), ("1500", "0", "250", "-90", "0", "-90")
POSE = {"translation_mm": [220.0, 0.0, 60.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]}
CAMERA = {
    "serial": "1",
    "focal_px": [9000.0, 9000.0],
    "principal_point_px": [1023.5, 543.5],
    "camera_from_tool": {"translation_mm": [0.0, 0.0, 250.0], "quaternion_wxyz": [1.0, 0.0, 0.0, 0.0]},
}


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A coarse CT around the plan, to be read only: 61 slices of 20 x 20 voxels of 10 mm, 3 mm apart.

    The head is a ball; the entry lies on it.
    """
    grid_mm, slices_mm = np.arange(-95.0, 100.0, 10.0), np.arange(-90.0, 91.0, 3.0)
    in_tissue = np.hypot(grid_mm[:, None], grid_mm) ** 2 + slices_mm[:, None, None] ** 2 < HEAD_MM**2
    voxels = np.where(in_tissue, 40, -1000).astype(np.int16)
    folder = tmp_path_factory.mktemp("series")
    return write_series(folder, voxels, (3.0, 10.0, 10.0), origin_mm=(-95.0, -95.0, -90.0))


@pytest.fixture
def case(tmp_path: Path, series: Path) -> tuple[Path, Path]:
    """A plan file of its own, and the series."""
    (tmp_path / "plan.toml").write_text(PLAN)
    return tmp_path / "plan.toml", series


@pytest.fixture
def theatre(tmp_path: Path) -> Path:
    """A theatre file with an arm and calibrations."""
    dated = {"created": datetime(2030, 1, 1, tzinfo=UTC), "expires": datetime(2030, 2, 1, tzinfo=UTC)}
    record = {"identifier": "r", **dated, "made_by": "test", "stated_error_mm": 0.05}
    endpoints = {"rsi": "udp://127.0.0.1:59152", "eki_project": "tcp://127.0.0.1:54602"}
    robot = {"driver": "kuka_rsi", "endpoints": endpoints, "options": {"variant": "kr6_r900_sixx"}}
    content = {
        "schema": 1,
        "theatre": "test",
        "robot": {"master": robot},
        "calibration": {
            "stereo_head": {**record, "flange_from_tool": POSE, "left": CAMERA, "right": CAMERA},
            "tool_tip": {**record, "tool_number": 2, "flange_from_tool": POSE},
            "tracker_frame": {**record, "tool": "M", "tool_from_marker": POSE},
        },
    }
    guide = {
        **{key: record[key] for key in ("identifier", "created", "expires", "made_by")},
        **{"purpose": "needle_guide", "number": 2, "flange": "changer", "tip": "r", "mass_kg": 1.0},
        "centre_of_gravity_mm": [0.0, 0.0, 50.0],
        "bore": {"reach_mm": 80.0, "length_mm": 90.0, "play_mm": 0.05},
        "gauge": {"joints_deg": [0.0, -95.0, 99.0, 0.0, 66.0, 180.0]},
    }
    content |= {"flange": "changer", "tools": {"guide": guide}}
    path = tmp_path / "theatre.toml"
    path.write_text(tomli_w.dumps(content))
    return path


def ronna_plan(*arguments: object) -> subprocess.CompletedProcess[str]:
    return in_this_process(app, *arguments)


def one_line(done: subprocess.CompletedProcess[str]) -> str:
    """The error: the only line of standard error that is no warning."""
    lines = [line for line in done.stderr.splitlines() if not line.startswith("warning:")]
    assert len(lines) == 1, done.stderr
    assert "Traceback" not in done.stderr
    return lines[0]


def test_the_sheet_of_a_plan_has_the_limits_and_the_depth_stop_of_its_theatre(
    case: tuple[Path, Path], theatre: Path, tmp_path: Path
) -> None:
    plan, series = case
    out = tmp_path / "sheet.html"
    done = in_this_process(app, "sheet", plan, "--ct", series, "--config", theatre, "--out", out)
    assert done.stdout == f"{out}\n"
    text = out.read_text()
    assert "the fiducials in the CT were not counted: CT-" in text
    planned = read_plan(plan)
    stop_mm = 90.0 + planned.standoff_mm + planned.trajectories[0].depth_mm
    assert f">{stop_mm:.1f}</td>" in text
    assert "clearance along a planned path, at least: <strong>10 mm</strong>" in text
    assert text.count("data:image/png") == len(planned.trajectories)


def test_a_good_plan_is_accepted_with_a_table(case):
    done = ronna_plan("check", case[0], "--ct", case[1])
    assert done.returncode == 0, done.stderr
    assert "T1" in done.stdout
    assert "\t50.2\t30\t-\t" in done.stdout  # depth, stand-off, no depth stop
    assert "depth stop fits on the instrument was not judged" in done.stderr
    assert "give --config and --robot-from-ct" in done.stderr
    assert "left" in done.stdout
    assert "Secret" not in done.stdout + done.stderr


def test_json_output_is_one_object_on_standard_output(case):
    done = ronna_plan("check", case[0], "--ct", case[1], "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert document["passed"] is True
    assert document["trajectories"] == [{"id": "T1", "side": "left", "depth_mm": 50.249, "margin_mm": 1.5}]
    assert document["findings"] == []
    uncounted, unjudged = document["warnings"]
    assert unjudged.startswith("whether the depth stop fits on the instrument was not judged")
    assert uncounted.startswith("the fiducials in the CT were not counted: CT-")


EXCHANGED = PLAN.replace("entry_mm", "x_mm").replace("target_mm", "entry_mm").replace("x_mm", "target_mm")
WRONG = {
    "outside": (PLAN.replace("60.0]", "110]"), 1, ("PLAN-006", "entry of trajectory T1")),
    "exchanged": (EXCHANGED, 1, ("PLAN-011",)),
    "x-frame": (
        PLAN.replace('"free"', '"xframe"').replace("= 4", "= 5"),
        1,
        ("PLAN-002", "the x-shaped frame has 4 spheres, 5 are implanted"),
    ),
    "three mistakes": (
        PLAN.replace("= 4", "= 12").replace('"HFS"', '"upright"').replace("margin_mm", "margin"),
        1,
        ("PLAN-002", "implanted", "patient_orientation", "margin_mm", "margin"),
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_plan_is_refused_in_one_line_with_all_its_errors(case, name):
    text, exit_code, said = WRONG[name]
    case[0].write_text(text)
    done = ronna_plan("check", case[0], "--ct", case[1])
    assert done.returncode == exit_code
    line = one_line(done)
    assert line.startswith(said[0])
    assert [part for part in said if part not in line] == []


@pytest.mark.hazard(9)
def test_a_plan_for_another_series_names_both_series(case):
    case[0].write_text(PLAN.replace(SERIES, "1.2.3.4"))
    done = ronna_plan("check", case[0], "--ct", case[1], "--json")
    assert done.returncode == 1
    line = one_line(done)
    assert line.startswith("PLAN-003")
    assert SERIES in line
    assert "1.2.3.4" in line
    assert json.loads(done.stdout)["findings"][0]["code"] == "PLAN-003"


TEMPLATE = "template_mm = [[0.0, 0.0, 0.0], [50.0, 0.0, 0.0], [0.0, 70.0, 0.0], [0.0, 0.0, 95.0]]"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (TEMPLATE.replace(", [0.0, 0.0, 95.0]", ""), "template_mm has 3 spheres, 4 are implanted"),
        (TEMPLATE.replace("95.0", "5.0"), "two spheres of template_mm coincide"),
        (TEMPLATE.replace("95.0", "nan"), "template_mm"),
    ],
)
def test_a_plan_with_an_invalid_template_is_refused(case, text, said):
    case[0].write_text(PLAN.replace('tool = "guide"', f'tool = "guide"\n{text}'))
    done = ronna_plan("check", case[0], "--ct", case[1])
    assert done.returncode == 1
    line = one_line(done)
    assert line.startswith("PLAN-002")
    assert said in line


def test_a_template_is_made_on_the_skin_of_a_ct(case, tmp_path):
    done = ronna_plan("template", "--ct", case[1], "--markers", "3", "--out", tmp_path / "t.toml", "--json")
    assert done.returncode == 0, done.stderr
    shown = json.loads(done.stdout)
    assert shown["least_difference_mm"] >= 10.0
    assert len(read_marker_template(tmp_path / "t.toml").markers) == len(shown["markers"]) == 3


SCENE = "[head]\ncentre_ct_mm = [0.0, 0.0, 0.0]\nsemi_axes_mm = [75.0, 95.0, 90.0]\n"


@pytest.mark.parametrize(
    ("arguments", "exit_code", "said"),
    [
        (("--scene", "scene.toml", "--margin", "40"), 1, ("PLAN-015", "40 mm")),
        (("--scene", "absent.toml"), 2, ("PLAN-016", "absent.toml")),
    ],
)
def test_an_impossible_template_gives_one_line(tmp_path, monkeypatch, arguments, exit_code, said):
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(SCENE)
    done = ronna_plan("template", "--out", "t.toml", *arguments)
    assert done.returncode == exit_code
    line = one_line(done)
    assert line.startswith(said[0])
    assert said[1] in line
    assert not Path("t.toml").exists()


def test_markers_are_proposed_only_on_the_head_of_the_plan(case, tmp_path):
    scene = tmp_path / "scene.toml"
    for target_mm, exit_code in (("[5.0, -20.0, 20.0]", 0), ("[5.0, -20.0, 20.1]", 1)):
        scene.write_text(f"{SCENE}\n[[head.targets]]\ntarget_ct_mm = {target_mm}\n")
        out = tmp_path / f"markers-{exit_code}.toml"
        done = ronna_plan("markers", case[0], "--scene", scene, "--out", out)
        assert (done.returncode, out.exists()) == (exit_code, not exit_code), done.stderr
    assert one_line(done).startswith("PLAN-003: scene.toml has none of the plan's targets")


def test_a_plan_with_a_different_number_of_fiducials_than_the_ct_is_refused(case, monkeypatch):
    three = [SimpleNamespace(centre_mm=np.array(one)) for one in ([0.0, 0, 0], [40, 0, 0], [0, 30, 10])]
    monkeypatch.setattr(
        "procedures.imaging.localize",
        lambda volume, progress: SimpleNamespace(markers=three, warnings=(), deformation=None),
    )
    done = ronna_plan("check", case[0], "--ct", case[1])
    assert (done.returncode, one_line(done)[:8]) == (1, "PLAN-008")


def test_markers_that_cannot_be_localized_give_the_error_of_the_localizer(case):
    done = ronna_plan("check", case[0], "--ct", case[1], "--markers")
    assert done.returncode != 0
    assert one_line(done).startswith("CT-")


def test_the_motions_of_the_arm_are_shown_before_anything_moves(case, theatre):
    done = ronna_plan("check", case[0], "--ct", case[1], "--config", theatre, "--robot-from-ct", *NEAR)
    assert done.returncode == 0, done.stderr
    assert "not judged" not in done.stderr
    assert "\t50.2\t30\t170.2\t" in done.stdout  # depth, stand-off, and with a bore of 90 the depth stop
    header, *motions = done.stdout.splitlines()[-12:]
    for word in ("s", "smallest distance mm", "singularity", "A1..A6 deg"):
        assert word in header.split("\t")
    assert [motion.split("\t")[:3] for motion in motions] == [
        *(gauge := [["home", "gauge", "move"], ["gauge", "home", "move"], ["home", "home", "move"]]),
        ["home", "T1/target", "move"],
        ["T1/target", "T1/target", "line"],
        ["T1/target", "T1/target", "back"],
        ["T1/target", "home", "move"],
        ["home", "home", "move"],  # each joint onto it from the same side
        *gauge,
    ]


def test_the_json_contains_a_preview_of_every_motion(case, theatre):
    done = ronna_plan(
        "check", case[0], "--ct", case[1], "--config", theatre, "--robot-from-ct", *NEAR, "--json"
    )
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert [(motion["from"], motion["to"]) for motion in document["motions"]] == [
        *(gauge := [("home", "gauge"), ("gauge", "home"), ("home", "home")]),
        ("home", "T1/target"),
        ("T1/target", "T1/target"),
        ("T1/target", "T1/target"),
        ("T1/target", "home"),
        ("home", "home"),
        *gauge,
    ]
    for motion in document["motions"]:
        assert motion["clear"]
        assert motion["duration_s"] > (0.05 if motion["from"] == motion["to"] == "home" else 0.5)
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
def test_a_body_of_the_cell_in_the_way_is_named_and_the_plan_refused(case, theatre):
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


def test_a_head_close_to_the_arm_at_home_gives_a_warning(case, theatre):
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


@pytest.mark.hazard(51)
def test_the_previews_are_those_of_the_driver_with_the_limits_of_the_theatre_file(case, theatre):
    content = tomllib.loads(theatre.read_text())
    content["robot"]["master"]["options"] |= {"speed_fraction": 0.03, "line_speed_mm_s": 20.0}
    theatre.write_text(tomli_w.dumps(content))
    done = ronna_plan(
        "check", case[0], "--ct", case[1], "--config", theatre, "--robot-from-ct", *NEAR, "--json"
    )
    motions = {(one["from"], one["kind"]): one for one in json.loads(done.stdout)["motions"]}
    arm = make_device("robot.master", read_theatre_file(theatre).robot["master"], HostClock())
    home_rad = arm.kinematics.home_rad
    gauge_rad = radians6(0.0, -95.0, 99.0, 0.0, 66.0, 180.0)
    to_gauge = arm.preview(JointMove(home_rad), start_rad=gauge_rad)
    assert motions["gauge", "move"]["duration_s"] == pytest.approx(to_gauge.duration_s, rel=0.02)
    assert motions["T1/target", "line"]["duration_s"] > 60.0 / (0.5 * 20.0)  # at half speed towards the skin
    assert motions["T1/target", "back"]["largest_speed_mm_s"] == pytest.approx(20.0, rel=0.02)


@pytest.mark.hazard(51)
def test_a_home_that_the_margin_forbids_is_refused_with_its_value_and_limit(case, theatre):
    content = tomllib.loads(theatre.read_text())
    content["robot"]["master"]["options"]["range_margin_deg"] = 30.0
    theatre.write_text(tomli_w.dumps(content))
    home = ("0", "-75", "99", "0", "100", "0")
    done = ronna_plan(
        "check", case[0], "--ct", case[1], "--config", theatre, "--robot-from-ct", *NEAR, "--home", *home
    )
    assert done.returncode == 3
    assert one_line(done).startswith("PLAN-007: home: A5 would leave its range")
    assert "limit -90.0 to 90.0 deg with the margin of 30, got 100.000 deg [ARM-003]" in done.stderr
    assert "wider range in the theatre file" in done.stderr


def test_a_structure_near_a_trajectory_is_listed_or_refuses_the_plan(case):
    case[0].write_text(PLAN + VESSEL)
    done = ronna_plan("check", case[0], "--ct", case[1])
    assert done.returncode == 0, done.stderr
    assert "vessel\tT1\t4.0\t3.0" in done.stdout
    case[0].write_text(PLAN + VESSEL.replace("margin_mm = 3.0", "margin_mm = 5.0"))
    done = ronna_plan("check", case[0], "--ct", case[1])
    assert (done.returncode, one_line(done)[:8]) == (1, "PLAN-027")


@pytest.mark.slow
def test_a_planner_whose_port_is_in_use_reports_it_and_leaves_the_plan_unchanged(case):
    before = case[0].read_bytes()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        line = [sys.executable, "-P", "-m", "procedures.cli.plan", "open", str(case[1])]
        done = subprocess.run(
            [*line, "--plan", str(case[0]), "--port", port], capture_output=True, text=True, check=False
        )
    assert done.returncode == EXIT_USAGE
    assert one_line(done).startswith("CON-001: port")
    assert case[0].read_bytes() == before


@pytest.mark.parametrize(
    ("record", "code"),
    [(fusion(ct_uid="1.2.3.4"), "FUS-007"), (fusion(other_uid="1.2.840.6"), "FUS-009")],
)
def test_the_planner_refuses_a_fusion_of_another_ct_or_series(
    case: tuple[Path, Path], tmp_path: Path, record: Fusion, code: str
) -> None:
    _, file, _, other = write_fused_mr(tmp_path, record)
    asked = PlannerRequest(series=case[1], plan=case[0], folder=tmp_path, fusion=file, other=other)
    done = in_this_process(planner, asked.model_dump_json())
    assert (done.returncode, one_line(done)[:7]) == (1, code)


def test_the_planner_needs_a_fusion_together_with_the_series_that_it_fuses(
    case: tuple[Path, Path], tmp_path: Path
) -> None:
    done = in_this_process(app, "open", case[1], *write_fused_mr(tmp_path)[:2])
    assert done.returncode == EXIT_USAGE
    assert "--fusion and --other belong together" in done.stderr


def test_a_plan_goes_to_slicer_and_back_and_one_outside_the_ct_is_refused(
    case: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, series = case
    spheres_mm = [(60.0, -40.0, 60.0), (-50.0, -45.0, 55.0), (5.0, 40.0, 80.0), (-60.0, 20.0, 70.0)]
    volume = read_series(series)
    monkeypatch.setattr(planning_inputs, "read_ct", lambda *_, **__: (volume, spheres_mm, ()))
    lines, back = tmp_path / "plan.mrk.json", tmp_path / "back.toml"
    assert in_this_process(app, "to-markups", plan, "--ct", series, "--out", lines).returncode == 0
    ordered = ("from-markups", lines, "--ct", series, "--instrument-length-mm", "250")
    done = in_this_process(app, *ordered, "--margin-mm", "1.5", "--out", back)
    assert done.returncode == 0, done.stderr
    assert "T1: middle" in done.stdout or "T1: left" in done.stdout
    assert read_plan(back).trajectories == read_plan(plan).trajectories
    drawn = json.loads(lines.read_text())
    drawn["markups"][0]["controlPoints"][0]["position"][2] += 100.0
    lines.write_text(json.dumps(drawn))
    wrong = in_this_process(app, *ordered, "--out", tmp_path / "wrong.toml")
    assert wrong.returncode == 1
    assert "PLAN-006" in wrong.stderr
    assert not (tmp_path / "wrong.toml").exists()
