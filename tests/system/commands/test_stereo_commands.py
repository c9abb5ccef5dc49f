"""`ronna-stereo` as a user runs it: on recorded observations, on a theatre, and with errors."""

from __future__ import annotations

import json
import subprocess
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from scipy.spatial.transform import Rotation
from shared_by_workers import made_once
from turned_camera import with_turned_camera, write_scene
from user_commands import Commands, in_this_process, one_error

from benchmarks.stereo_head.head_looks import ENDPOINTS, TrueHead, check_looks, observation_set, true_head
from benchmarks.stereo_head.stereo_cell import with_ideal_arm
from procedures.calibration import Baseline
from procedures.calibration.observations import OBSERVATIONS_FILE, Observation
from procedures.calibration.pose_set import PlannedLook, plan_calibration_looks
from procedures.calibration.self_check import BASELINE_FILE
from procedures.cli.calibrating.calibration import NOT_COMPARED
from procedures.cli.stereo.command import app
from procedures.journal.journal import JOURNAL_FILE, Entry, read_journal
from procedures.runs.theatre_history import history_path
from ronna_hw.calibration import StereoHeadCalibration, ToolTipCalibration
from ronna_hw.config import read_theatre_file
from ronna_hw.control_port import ask_control_port
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.manifest import REPORT_FILE
from ronna_hw.frames import Transform
from ronna_hw.host.child_process import ChildProcess, command
from sim.theatre.theatre_file import theatre_content
from sim.world.scene.model import Scene
from sim.world.scene.named_scenes import draw_scene

GOAL_MM = 0.03
BALL_MM = np.array([700.0, 20.0, 250.0])
TOOL_DOWN = Rotation.from_matrix(np.diag([1.0, -1.0, -1.0]))
NEVER = datetime(9999, 1, 1, tzinfo=UTC)  # in measurements of former versions: a record to start from


@pytest.fixture(autouse=True)
def own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What a command leaves without `--out` is left here."""
    monkeypatch.chdir(tmp_path)


def stereo(*arguments: object) -> subprocess.CompletedProcess[str]:
    return in_this_process(app, *arguments)


@pytest.fixture(scope="module")
def head() -> TrueHead:
    return true_head(seed=4)


def recorded(
    head: TrueHead,
    folder: Path,
    plan: Sequence[PlannedLook] | None = None,
    tool_tip: ToolTipCalibration | None = None,
) -> Path:
    """A folder with observations, as `calibrate` keeps it."""
    generator = np.random.default_rng(4)
    if plan is None:
        checks = check_looks(TOOL_DOWN, BALL_MM)
        plan = [*plan_calibration_looks(TOOL_DOWN, BALL_MM, 60), *checks, *checks, *checks]
    looks: list[Observation] = [head.observe(look, BALL_MM, generator) for look in plan]
    observed = observation_set(head, looks).model_copy(update={"tool_tip": tool_tip})
    (folder / OBSERVATIONS_FILE).write_text(observed.model_dump_json(by_alias=True))
    return folder


def of_one_orientation() -> list[PlannedLook]:
    looks = []
    for look in plan_calibration_looks(TOOL_DOWN, BALL_MM, 64):
        offset = np.array(look.ball_in_tool_mm)
        rigid = type(look.pose.rigid).from_components(BALL_MM - TOOL_DOWN.apply(offset), TOOL_DOWN)
        looks.append(PlannedLook(Transform(look.pose.target, look.pose.source, rigid), look.ball_in_tool_mm))
    return looks


def theatre_file(head: TrueHead, folder: Path) -> Path:
    """A theatre file at whose endpoints nobody answers."""
    content = theatre_content(head.scene, ENDPOINTS, "host:", {}, 1.0)
    path = folder / "theatre.toml"
    path.write_text(tomli_w.dumps(content))
    return path


def test_recorded_observations_give_records_a_baseline_and_a_theatre_file(
    head: TrueHead, tmp_path: Path
) -> None:
    theatre = theatre_file(head, tmp_path)
    before = read_theatre_file(theatre).calibration
    assert before is not None
    looks = recorded(head, tmp_path, tool_tip=before.tool_tip.model_copy(update={"expires": NEVER}))
    options = ("--out", tmp_path / "out", "--days", "7", "--config", theatre, "--update", "--json")
    said = stereo("calibrate", "--from", looks, *options)
    assert said.returncode == 0, said.stderr
    printed = json.loads(said.stdout)
    folder = Path(printed["folder"])
    assert printed["poses"] == 84
    records = tomllib.loads((folder / "calibration.toml").read_text())["calibration"]
    assert (
        head.tool_centre_error_mm(StereoHeadCalibration.model_validate(_tuples(records["stereo_head"])))
        <= GOAL_MM
    )
    assert (folder / "baseline.json").is_file()
    calibrations = read_theatre_file(theatre).calibration
    assert calibrations is not None
    assert calibrations.stereo_head.identifier == printed["calibration"]
    assert calibrations.stereo_head.expires - calibrations.stereo_head.created == timedelta(days=7)
    assert calibrations.tracker_frame == before.tracker_frame
    assert calibrations.tool_tip.expires == before.tool_tip.expires
    assert calibrations.tool_tip.flange_from_tool != before.tool_tip.flange_from_tool  # it shares the mount


@pytest.mark.slow
def test_a_calibration_computed_again_may_shorten_its_life_in_the_theatre_file(
    head: TrueHead, tmp_path: Path
) -> None:
    theatre = theatre_file(head, tmp_path)
    before = read_theatre_file(theatre).calibration
    assert before is not None
    looks = recorded(head, tmp_path, tool_tip=before.tool_tip)
    for days in ("30", "7"):
        out = ("--out", tmp_path / days, "--days", days, "--config", theatre, "--update")
        assert stereo("calibrate", "--from", looks, *out).returncode == 0
    calibrations = read_theatre_file(theatre).calibration
    assert calibrations is not None
    assert calibrations.stereo_head.expires - calibrations.stereo_head.created == timedelta(days=7)


def test_an_incomplete_baseline_is_reported_and_not_written(head: TrueHead, tmp_path: Path) -> None:
    plan = [*plan_calibration_looks(TOOL_DOWN, BALL_MM, 60), *2 * check_looks(TOOL_DOWN, BALL_MM)[:5]]
    said = stereo("calibrate", "--from", recorded(head, tmp_path, plan), "--out", tmp_path / "out", "--json")
    assert said.returncode == 0, said.stderr
    assert said.stderr == (
        "warning: ronna-stereo check cannot use this calibration: "
        f"the baseline has too few orientations; expected 8, got 5\n{NOT_COMPARED}\n"
    )
    folder = json.loads(said.stdout)["folder"]
    assert not (Path(folder) / BASELINE_FILE).exists()
    check = stereo("check", "--config", theatre_file(head, tmp_path), "--baseline", folder)
    assert one_error(check.stderr)[0].startswith(f"CAL-008: {folder} has no {BASELINE_FILE}")


@pytest.mark.parametrize("orientations", [5, 0])
def test_a_check_with_an_incomplete_baseline_is_refused_before_anything_is_measured(
    head: TrueHead, tmp_path: Path, orientations: int
) -> None:
    generator = np.random.default_rng(4)
    plan = 2 * check_looks(TOOL_DOWN, BALL_MM)[:orientations]
    baseline = Baseline(
        created=NEVER,
        stereo_head=head.record,
        arm_variant="kr6_r900_sixx",
        looks=tuple(head.observe(look, BALL_MM, generator) for look in plan),
    )
    file = tmp_path / BASELINE_FILE
    file.write_text(baseline.model_dump_json(by_alias=True))
    out = tmp_path / "out"
    said = stereo("check", "--config", theatre_file(head, tmp_path), "--baseline", file, "--out", out)
    assert one_error(said.stderr)[0].startswith("CAL-008: the baseline has too few orientations")
    assert not out.exists()


@pytest.mark.hazard(3)
def test_observations_with_another_tip_are_refused_and_nothing_is_written(
    head: TrueHead, tmp_path: Path
) -> None:
    theatre = theatre_file(head, tmp_path)
    before = read_theatre_file(theatre).calibration
    assert before is not None
    other = before.tool_tip.model_copy(update={"identifier": "tool-tip-of-another-guide"})
    run = ("calibrate", "--from", recorded(head, tmp_path, tool_tip=other), "--out", tmp_path / "out")
    said = stereo(*run, "--config", theatre, "--update")
    assert said.stderr.startswith("CAL-020")
    assert f"expected {before.tool_tip.identifier}, got tool-tip-of-another-guide" in said.stderr
    assert not history_path(theatre).exists()


def _tuples(value):
    if isinstance(value, dict):
        return {key: _tuples(item) for key, item in value.items()}
    return tuple(_tuples(item) for item in value) if isinstance(value, list) else value


def test_bad_recordings_are_refused_with_their_codes(head: TrueHead, tmp_path: Path) -> None:
    few, one_way = tmp_path / "few", tmp_path / "one-way"
    for folder in (few, one_way):
        folder.mkdir()
    recorded(head, few, plan_calibration_looks(TOOL_DOWN, BALL_MM, 59))
    recorded(head, one_way, of_one_orientation())
    for folder, code in ((few, "CAL-002"), (one_way, "CAL-003"), (tmp_path / "nowhere", "CAL-005")):
        said = stereo("calibrate", "--from", folder, "--out", tmp_path / "out")
        assert said.returncode == 1
        assert one_error(said.stderr)[0].startswith(code)
        assert said.stdout == ""


def test_a_theatre_without_calibration_is_refused(head: TrueHead, tmp_path: Path) -> None:
    content = theatre_content(head.scene, ENDPOINTS, "host:", {}, 1.0)
    del content["calibration"]
    (tmp_path / "theatre.toml").write_text(tomli_w.dumps(content))
    said = stereo("measure", "--config", tmp_path / "theatre.toml")
    assert said.returncode == 2
    assert one_error(said.stderr)[0].startswith("DEV-007")
    assert list(Path("calibrations").iterdir()) == []


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[ChildProcess]:
    """A running mini theatre; the arm stands at home, where no ball is in view."""
    folder = tmp_path_factory.mktemp("theatre")
    with ChildProcess(
        "theatre", command("sim.cli", "theatre", "--scene", "mini", "--out", str(folder)), timeout_s=30.0
    ) as theatre:
        yield theatre


@pytest.fixture(scope="module")
def theatre(running: ChildProcess) -> Path:
    """Its theatre file."""
    return Path(running.ready["file"])


@pytest.fixture
def fault(running: ChildProcess) -> Iterator[Callable[[str], None]]:
    """Switches a fault on in the theatre for the rest of the test."""
    control = running.ready["endpoints"]["control"]
    yield lambda line: ask_control_port(control, "fault", line=f"now: {line}")
    ask_control_port(control, "clear_faults")


UNMEASURABLE = [
    (None, "STE-002: both cameras: the image is completely dark"),
    pytest.param(
        *("camera darken right", "STE-002: both cameras: the image is completely dark"),
        marks=pytest.mark.slow,
    ),
    pytest.param(
        *("camera saturate both", "STE-011: both cameras: the image is saturated"), marks=pytest.mark.slow
    ),
    ("camera saturate left", "STE-011: left camera: the image is saturated; right camera: the image is"),
    ("camera glare left 90 px", "STE-003: left camera: no sphere in view; right camera: the image is"),
]


@pytest.mark.hazard(27)
@pytest.mark.parametrize(("line", "shown"), UNMEASURABLE)
def test_images_without_a_measurable_ball_are_refused_and_the_run_is_kept(
    theatre: Path,
    fault: Callable[[str], None],
    tmp_path: Path,
    line: str | None,
    shown: str,
) -> None:
    if line is not None:
        fault(line)
    picture = tmp_path / "pair.png"
    said = stereo("measure", "--config", theatre, "--picture", picture)
    assert said.returncode == 1
    assert one_error(said.stderr)[0].startswith(shown)
    (run,) = Path("calibrations").iterdir()
    assert shown.partition(":")[0] in (run / REPORT_FILE).read_text()
    assert inspect_run(run).problems == ()
    if "STE-011" not in shown:
        assert picture.read_bytes().startswith(b"\x89PNG")  # what was seen instead


def test_without_a_terminal_nothing_is_confirmed_and_nothing_moves(theatre: Path, tmp_path: Path) -> None:
    said = stereo("calibrate", "--config", theatre, "--ball", "720", "-10", "310", "--out", tmp_path)
    assert said.returncode == 7
    assert one_error(said.stderr)[0].startswith("PRO-002")
    (run,) = tmp_path.iterdir()
    assert "ball_observation failed. PRO-002" in (run / REPORT_FILE).read_text()
    assert [line for line in read_journal(run / JOURNAL_FILE) if line["entry"] == Entry.MOTION] == []


@dataclass(frozen=True)
class Calibrated:
    """A calibration on the simulated theatre, through the wire."""

    scene: Scene
    scene_file: Path
    said: dict
    folder: Path


@pytest.fixture(scope="module")
def calibrated(shared_commands: Commands, tmp_path_factory: pytest.TempPathFactory) -> Calibrated:
    scene = with_ideal_arm(draw_scene("mini", seed=0))

    def calibrate(folder: Path) -> str:
        folder.mkdir()
        file = write_scene(scene, folder / "scene.json")
        done = shared_commands.run(
            *("ronna-stereo", "calibrate", "--sim", "--scene", str(file), "--out", str(folder), "--json"),
            timeout_s=280.0,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    folder, shown = made_once(tmp_path_factory, "calibrated", calibrate)
    said = json.loads(shown)
    return Calibrated(scene, folder / "scene.json", said, Path(said["folder"]))


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_over_the_wire_the_tool_centre_is_within_three_hundredths_of_a_millimetre(
    calibrated: Calibrated,
) -> None:
    records = tomllib.loads((calibrated.folder / "calibration.toml").read_text())["calibration"]
    record = StereoHeadCalibration.model_validate(_tuples(records["stereo_head"]))
    truth = TrueHead(calibrated.scene)
    assert calibrated.said["poses"] >= 60
    assert calibrated.said["tool_shift_mm"] > 0.5
    assert truth.tool_centre_error_mm(record) <= GOAL_MM
    assert calibrated.said["tool_error_mm"] <= GOAL_MM
    in_use = read_theatre_file(calibrated.folder / "theatre" / "theatre.toml").calibration
    assert in_use is not None
    assert records["tool_tip"]["expires"] == in_use.tool_tip.expires


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_over_the_wire_a_hundredth_of_a_degree_is_detected_and_a_sound_head_passes(
    calibrated: Calibrated, commands: Commands, tmp_path: Path
) -> None:
    turned = write_scene(with_turned_camera(calibrated.scene, 0.01), tmp_path / "turned.json")
    for scene, code in ((calibrated.scene_file, 0), (turned, 3)):
        done = commands.run(
            *("ronna-stereo", "check", "--sim", "--scene", str(scene)),
            *("--baseline", str(calibrated.folder), "--json"),
            timeout_s=140.0,
        )
        assert done.returncode == code, done.stderr
        assert json.loads(done.stdout)["passed"] is (code == 0)
    assert one_error(done.stderr)[0].startswith("CAL-006")


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_measure_reports_the_ball_and_saves_its_picture(commands: Commands, tmp_path: Path) -> None:
    picture = tmp_path / "pair.png"
    done = commands.run(
        *("ronna-stereo", "measure", "--sim", "--scene", "mini", "--picture", str(picture), "--json"),
        timeout_s=140.0,
    )
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["left"]["status"] == said["right"]["status"] == "OK"
    assert said["radius_mm"] == pytest.approx(5.75, abs=0.05)
    assert np.linalg.norm(said["position_mm"]) < 3.0
    assert picture.read_bytes().startswith(b"\x89PNG")
