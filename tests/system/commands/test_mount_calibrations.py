"""`ronna-procedure calibrate` as a user runs it: from the how-to pages, on stored data, with bad input."""

from __future__ import annotations

import json
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from arm_looks import ENDPOINTS
from documented import commands_of, run_all
from user_commands import Commands, in_this_process, one_error

from benchmarks.mount.tool_tip_calibration import TipCell
from benchmarks.mount.tracker_frame_calibration import FrameCell
from procedures.calibration import tip_calibration
from procedures.calibration.frame_calibration import LOOKS_FILE
from procedures.calibration.tip_calibration import LEAST_READINGS
from procedures.cli.procedure import app
from procedures.runs.theatre_history import history_path
from sim.theatre.theatre_file import theatre_content, write_theatre_file
from sim.world.scene.model import Scene, read_scene
from sim.world.scene.named_scenes import draw_scene


@pytest.fixture
def looks(tmp_path: Path) -> Path:
    """Looks at the reference frame as a calibration leaves them."""
    folder = tmp_path / "before"
    folder.mkdir()
    observed = FrameCell.of(3, calibrated=True).looks(15, 5)
    (folder / LOOKS_FILE).write_text(observed.model_dump_json(by_alias=True))
    return folder


def test_stored_looks_are_recomputed_into_a_record_for_the_theatre_file(looks: Path, tmp_path: Path) -> None:
    run = ("calibrate", "tracker-frame", "--from", looks, "--out", tmp_path / "out")
    done = in_this_process(app, *run, "--json")
    assert done.returncode == 0, done.stderr
    payload = json.loads(done.stdout)
    records = tomllib.loads((Path(payload["folder"]) / "calibration.toml").read_text())["calibration"]
    assert records["tracker_frame"]["identifier"] == payload["calibration"]
    assert payload["error_mm"] < 0.05
    shown = in_this_process(app, *run)
    assert "contribution of the arm, mm" in shown.stdout


@pytest.mark.slow
def test_stored_looks_can_be_written_directly_into_the_theatre_file(looks: Path, tmp_path: Path) -> None:
    scene = FrameCell.of(3, calibrated=True).scene
    theatre = theatre_of(tmp_path, scene)
    run = ("calibrate", "tracker-frame", "--from", looks, "--out", tmp_path / "out", "--json")
    done = in_this_process(app, *run, "--config", theatre, "--update")
    assert done.returncode == 0, done.stderr
    frame = tomllib.loads(theatre.read_text())["calibration"]["tracker_frame"]
    assert frame["identifier"] == json.loads(done.stdout)["calibration"]
    again = in_this_process(app, *run, "--config", theatre, "--update")
    assert again.returncode == 0, again.stderr


def theatre_of(folder: Path, scene: Scene) -> Path:
    file = folder / "theatre.toml"
    write_theatre_file(theatre_content(scene, ENDPOINTS, "host:", {}, 1.0), file)
    return file


@pytest.mark.hazard(3)
@pytest.mark.parametrize(("stored", "command"), [("looks", "tracker-frame"), ("readings", "tool-tip")])
def test_measurements_of_another_theatre_are_refused_and_nothing_is_written(
    request: pytest.FixtureRequest, tmp_path: Path, stored: str, command: str
) -> None:
    theatre = theatre_of(tmp_path, draw_scene("default", seed=4))
    run = ("calibrate", command, "--from", request.getfixturevalue(stored), "--config", theatre)
    done = in_this_process(app, *run, "--update", "--out", tmp_path / "out")
    (error, *_) = one_error(done.stderr)
    assert error.startswith("CAL-020")
    assert "[calibration.stereo_head]" in error
    assert "expected stereo-head-default-4, got stereo-head-default-3" in error
    assert not history_path(theatre).exists()
    assert not (tmp_path / "out").exists()


@pytest.mark.hazard(3)
def test_readings_of_a_tip_that_was_edited_since_are_refused(readings: Path, tmp_path: Path) -> None:
    theatre = theatre_of(tmp_path, draw_scene("default", seed=3))
    stored = json.loads((readings / tip_calibration.LOOKS_FILE).read_text())
    stored["start"]["flange_from_tool"]["translation_mm"][0] += 0.5
    (readings / tip_calibration.LOOKS_FILE).write_text(json.dumps(stored))
    run = ("calibrate", "tool-tip", "--from", readings, "--config", theatre, "--out", tmp_path / "out")
    done = in_this_process(app, *run, "--update")
    (error, *_) = one_error(done.stderr)
    assert error.startswith("CAL-020")
    assert "[calibration.tool_tip]" in error
    assert "with other numbers" in error
    assert not history_path(theatre).exists()


def test_a_record_in_metres_is_recognized_by_its_magnitude_and_refused(looks: Path, tmp_path: Path) -> None:
    stored = json.loads((looks / LOOKS_FILE).read_text())
    stored["start"]["tool_from_marker"]["translation_mm"] = [-0.15, 0.0, -0.14]
    (looks / LOOKS_FILE).write_text(json.dumps(stored))
    done = in_this_process(app, "calibrate", "tracker-frame", "--from", looks, "--out", tmp_path / "out")
    (error, *_) = one_error(done.stderr)
    assert error.startswith("CAL-005")
    assert "start.tool_from_marker.translation_mm: has length 0.205: give millimetres, not metres" in error


@pytest.fixture
def readings(tmp_path: Path) -> Path:
    """Readings of the divot as a calibration leaves them."""
    folder = tmp_path / "before"
    folder.mkdir()
    observed = TipCell.of(3, calibrated=False).readings(8, 3)
    (folder / tip_calibration.LOOKS_FILE).write_text(observed.model_dump_json(by_alias=True))
    return folder


def test_stored_readings_are_recomputed_into_a_tip_record(readings: Path, tmp_path: Path) -> None:
    run = ("calibrate", "tool-tip", "--from", readings, "--out", tmp_path / "out")
    done = in_this_process(app, *run, "--json")
    assert done.returncode == 0, done.stderr
    payload = json.loads(done.stdout)
    records = tomllib.loads((Path(payload["folder"]) / "calibration.toml").read_text())["calibration"]
    assert records["tool_tip"]["identifier"] == payload["calibration"]
    assert payload["stated_error_mm"] < 0.05
    assert "offset of the divot from the ball by pivoting, mm" in in_this_process(app, *run).stdout


def test_too_few_readings_are_refused_with_the_required_number(readings: Path, tmp_path: Path) -> None:
    stored = json.loads((readings / tip_calibration.LOOKS_FILE).read_text())
    stored["readings"] = stored["readings"][:4]
    (readings / tip_calibration.LOOKS_FILE).write_text(json.dumps(stored))
    done = in_this_process(app, "calibrate", "tool-tip", "--from", readings, "--out", tmp_path / "out")
    assert f"at least {LEAST_READINGS}" in " ".join(one_error(done.stderr))


def test_first_day_records_are_accepted_with_a_simulated_theatre_only(tmp_path: Path) -> None:
    theatre = tmp_path / "theatre.toml"
    write_theatre_file(theatre_content(draw_scene("mini", seed=3), ENDPOINTS, "host:", {}, 1.0), theatre)
    for more in (("--first-day",), ("--calibration", tmp_path)):
        done = in_this_process(app, "calibrate", "tool-tip", "--config", theatre, *more)
        assert done.returncode == 2
        assert f"{more[0]} and --config cannot be combined" in " ".join(one_error(done.stderr))


@pytest.mark.parametrize("text", [None, "calibration = 3", "[calibration.tip]\nx = 1"])
@pytest.mark.parametrize("command", [("run",), ("calibrate", "tool-tip")])
def test_a_file_without_calibration_records_is_refused_before_anything_starts(
    command: tuple[str, ...], text: str | None, tmp_path: Path
) -> None:
    records = tmp_path / "calibration.toml"
    if text is not None:
        records.write_text(text)
    done = in_this_process(app, *command, "--sim", "--calibration", records, "--out", tmp_path / "out")
    assert one_error(done.stderr)[0].startswith("CAL-005")
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.timeout(400)
def test_a_first_day_case_is_refused_then_calibrated_and_completes(
    commands: Commands, tmp_path: Path
) -> None:
    refused, frame, tip, case = commands_of("docs/how-to/calibration/calibrate-tool-tip.md")[-4:]
    said = run_all([refused], commands, tmp_path)[0].stderr
    assert re.search(
        "CAL-001: calibration tool-tip-as-drawn expired on .*; calibration tracker-frame-as-drawn expired on",
        said,
    )
    first, then = (f"ronna-procedure calibrate {what} --sim" for what in ("tracker-frame", "tool-tip"))
    assert said.index(first) < said.index(then)
    assert "ct_import" not in said  # before anything is asked or read
    assert not (tmp_path / "runs").exists()
    run_all([frame, tip], commands, tmp_path)
    done = run_all([case], commands, tmp_path)[0]
    assert "T1" in done.stdout


@pytest.mark.slow
@pytest.mark.timeout(200)
def test_the_page_about_the_tip_works(commands: Commands, tmp_path: Path) -> None:
    made, replayed, *_ = commands_of("docs/how-to/calibration/calibrate-tool-tip.md")
    assert replayed.startswith("ronna-procedure replay")
    run_all([made, replayed], commands, tmp_path)
    (folder,) = (tmp_path / "calibrations").iterdir()
    record = tomllib.loads((folder / "calibration.toml").read_text())["calibration"]["tool_tip"]
    scene = read_scene(folder / "theatre" / "scene.json")
    designed = scene.mount.flange_from_tool_nominal.translation_mm
    true = np.add(designed, scene.mount.tool_from_tip_true.translation_mm)
    assert np.linalg.norm(record["flange_from_tool"]["translation_mm"] - true) <= 0.05


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_the_page_about_the_reference_frame_works(commands: Commands, tmp_path: Path) -> None:
    lines = commands_of("docs/how-to/calibration/calibrate-tracker-frame.md")
    assert lines
    run_all(lines, commands, tmp_path)
    (folder,) = (tmp_path / "calibrations").iterdir()
    assert (folder / "report.html").is_file()
