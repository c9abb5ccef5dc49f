"""`ronna-arm` as a user runs it: on recorded measurements, on a simulated theatre, and with errors."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest
from arm_looks import ENDPOINTS, SPHERES_MM, LookingArm
from user_commands import in_this_process, one_error

from procedures.calibration.arm_model import LOOKS_FILE
from procedures.cli.arm.command import app
from ronna_hw.config import parse_theatre
from sim.theatre.theatre_file import theatre_content, write_theatre_file
from sim.world.scene.named_scenes import draw_scene


@pytest.fixture
def looks(tmp_path: Path) -> Path:
    """Looks as a calibration leaves them."""
    folder = tmp_path / "before"
    folder.mkdir()
    observed = LookingArm.of(3).looks(90, 24, SPHERES_MM)
    (folder / LOOKS_FILE).write_text(observed.model_dump_json(by_alias=True))
    return folder


def test_recorded_looks_are_recomputed_into_records_for_the_theatre_file(looks: Path, tmp_path: Path) -> None:
    done = in_this_process(app, "calibrate", "--from", looks, "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    payload = json.loads(done.stdout)
    assert payload["error_mm"] < 0.04 < payload["before_mm"]
    records = tomllib.loads((Path(payload["folder"]) / "calibration.toml").read_text())["calibration"]
    content = theatre_content(draw_scene("mini", seed=3), ENDPOINTS, "host:", {}, 1.0)
    content["calibration"] |= records
    assert parse_theatre(content).calibration is not None


def test_the_table_names_the_parameters_that_the_looks_do_not_determine(looks: Path, tmp_path: Path) -> None:
    done = in_this_process(app, "calibrate", "--from", looks, "--out", tmp_path / "out")
    assert "not determined by the measurements" in done.stdout
    assert "A1 offset" in done.stdout


@pytest.mark.parametrize(
    ("content", "code"),
    [("", "CAL-005"), ('{"schema": 1}', "CAL-005"), ('{"schema": 2}', "CAL-005")],
)
def test_a_damaged_looks_file_is_refused(tmp_path: Path, content: str, code: str) -> None:
    (tmp_path / LOOKS_FILE).write_text(content)
    done = in_this_process(app, "calibrate", "--from", tmp_path, "--out", tmp_path / "out")
    assert code in " ".join(one_error(done.stderr))


def test_too_few_looks_are_refused_with_the_required_number(looks: Path, tmp_path: Path) -> None:
    stored = json.loads((looks / LOOKS_FILE).read_text())
    stored["looks"] = stored["looks"][:30]
    (looks / LOOKS_FILE).write_text(json.dumps(stored))
    done = in_this_process(app, "calibrate", "--from", looks, "--out", tmp_path / "out")
    assert "at least 60" in " ".join(one_error(done.stderr))


def test_calibrated_requires_a_record_in_the_theatre_file(tmp_path: Path) -> None:
    from procedures.cli.procedure import app as procedure

    path = tmp_path / "theatre.toml"
    write_theatre_file(theatre_content(draw_scene("mini", seed=3), ENDPOINTS, "host:", {}, 1.0), path)
    done = in_this_process(procedure, "run", "--config", path, "--case", tmp_path, "--calibrated")
    assert "CAL-014" in " ".join(one_error(done.stderr))
    assert done.returncode == 3


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_a_simulated_theatre_is_calibrated_and_checked(tmp_path: Path) -> None:
    sim = ("--sim", "--scene", "mini", "--seed", "3", "--out", tmp_path, "--json")
    done = in_this_process(app, "calibrate", "--looks", "60", "--validation", "12", *sim)
    assert done.returncode == 0, done.stderr
    payload = json.loads(done.stdout)
    assert payload["error_mm"] < 0.06 < payload["before_mm"]
    assert (Path(payload["folder"]) / "report.html").is_file()
    checked = in_this_process(app, "check", "--looks", "12", *sim)
    assert checked.returncode == 0, checked.stderr
    assert json.loads(checked.stdout)["passed"]


def test_a_tool_is_drawn_on_the_arm_of_its_theatre_alone(tmp_path: Path) -> None:
    file = tmp_path / "theatre.toml"
    write_theatre_file(theatre_content(draw_scene("mini", seed=3), ENDPOINTS, "host:", {}, 1.0), file)
    done = in_this_process(app, "urdf", "kr6", "--config", file)
    assert 'link name="flange"' in done.stdout
    refused = in_this_process(app, "urdf", "ur5e", "--config", file)
    assert "CLI-001" in refused.stderr
    assert "expected kr6_r900_sixx, got ur5e" in refused.stderr
