"""The whole case on the mini scene, through real sockets and serial lines."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from signal import SIGHUP, SIGINT, SIGTERM
from typing import Any

import numpy as np
import pydicom
import pytest
from documented import python_of, read_page
from pseudo_terminal import Terminal
from report_figures import figures_in, figures_of_records
from run_folders import assert_nothing_half_written, await_motion_in, moved_in, records_of, run_folder
from scipy.spatial.distance import cdist
from shared_by_workers import made_once
from simulated_case import SimulatedCase
from undisturbed import MINI_SEED_7, finished_mini
from user_commands import Commands, in_this_process
from waiting import HANG_LIMIT_S

from procedures.cli.procedure import app as ronna_procedure
from procedures.guards.room_reading import FRAMES as ROOM_FRAMES
from procedures.journal.journal import JOURNAL_FILE, read_journal
from procedures.journal.results import FramedPose
from procedures.registration import register
from procedures.workcell.tracker_look import FRAMES
from ronna_hw import load_run
from ronna_hw.devices.capabilities import Direction
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.recording.flight_recorder import BYTES_FOLDER, list_links, read_link
from sim.cli import app as ronna_sim
from sim.world.displacements import spheres_in_theatre
from sim.world.rigid import apply, matrix_of
from sim.world.scene.model import read_scene
from studies.accuracy.postures import ARM, TOOL_MM
from studies.accuracy.random_arms import PlannedPoses, RandomArms, centre_on_spheres

LARGEST_ERROR_MM = 1.5
TRACKER_NOISE_MM = 0.3  # of one reading, along the line of sight
TRACKER_MM = 0.2  # of 1,500 drawn scenes the largest is 0.12 mm: the smooth error of both frames is the same
WIRES_APART_MM = 0.1  # repeatability, and the stereo head's calibration record: 0.03 mm each per axis
DATED = {"set_up", "tool_change"}  # equal only if both runs began in the same second
MEASURED = {
    "ct_import", "fiducial_localization", "plan_check", "head_clamp", "cart_lock", "global_localization",
    "correspondence", "path_check", "relocalization", "registration", "tool_check",
}  # fmt: skip
MOVING = "positioning:T1"
FACTS = re.compile(  # what moves, how far, what follows, how close to what and to the head, how fast
    r"first: the (stereo head|guide) moves \d+ mm\nthen: .+\n"
    r"closest: ([a-z ]+ clears [a-z ]+ by \d+ mm)(, at least \d+ mm from the head)?(; later .*)?\n"
    r"speed: up to \d+ mm/s, in \d+\.\d s; joints turn up to \d+(?:\.\d)? deg(; later .*)?"
)


class MiniRun:
    """A finished run: what it printed and its folder."""

    def __init__(self, out: Path, printed: str) -> None:
        self.outcome: dict[str, Any] = json.loads(printed)
        self.out = out
        self.folder = out / self.outcome["run"]


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> MiniRun:
    return MiniRun(*finished_mini(tmp_path_factory))


def test_the_run_loads_as_arrays_that_agree_with_its_outcome_and_its_records(finished: MiniRun) -> None:
    run = load_run(finished.folder)
    assert (run.outcome, run.notes) == ("done", ())
    (target,) = run.targets
    (expected,) = finished.outcome["targets"]
    assert (target.name, target.error_mm) == (expected["id"], expected["application_error_mm"])
    assert (target.predicted_mm, target.depth_mm) == (expected["predicted_tre_mm"], expected["depth_mm"])
    (reached,) = (one for one in records_of(finished.folder) if one.kind == "at_target")
    assert np.linalg.norm(target.reached_robot_mm - target.target_robot_mm) == pytest.approx(
        reached.payload["nominal_error_mm"], abs=0.001
    )
    assert run.spheres.name.tolist() == ["M1", "M2", "M3"]
    strays = run.strays
    for sphere in range(3):  # of the mini scene, each the same in every look of the tracker
        place_mm = strays.position_tracker_mm[strays.identity == sphere]
        assert len(place_mm) > 500
        assert place_mm.std(axis=0).max() < TRACKER_NOISE_MM
    assert len(run.looks) == len(run.pictures) == run.localized.looks.sum()
    assert np.isfinite(run.motions.end_s).all()
    assert (run.events.number[1:] >= run.events.number[:-1]).all()


def test_the_arrays_give_the_registration_of_the_run_and_add_up_to_its_prediction(finished: MiniRun) -> None:
    run = load_run(finished.folder)
    (target,), localized, budget = run.targets, run.localized, run.budget
    assert localized.sphere.tolist() == run.spheres.name.tolist()
    fit = register(
        run.spheres.centre_ct_mm,
        localized.centre_robot_mm,
        covariance_mm2=localized.total_covariance_robot_mm2,
    )
    recorded = run.robot_from_ct(target.name)
    np.testing.assert_allclose(fit.between("robot", "ct").as_matrix(), recorded.as_matrix(), atol=1e-9)
    assert np.linalg.norm(budget.rms_mm) == pytest.approx(target.predicted_mm)
    # Those of the spheres, with the arm's as if each sphere had its own: most of the prediction, and not all.
    (spheres_mm,) = fit.predict_tre_mm(target.target_ct_mm)
    assert 0.5 * target.predicted_mm < spheres_mm < target.predicted_mm


@pytest.mark.slow
def test_the_page_on_runs_in_python_works_as_written(finished: MiniRun, tmp_path: Path) -> None:
    (tmp_path / "runs").symlink_to(finished.out)
    page = "docs/how-to/research/read-a-run-in-python.md"
    program = python_of(page)
    line = [sys.executable, "-W", "error", "-c", program]
    done = subprocess.run(line, cwd=tmp_path, capture_output=True, text=True, timeout=100.0, check=False)
    assert done.returncode == 0, done.stderr
    assert "sphere 2: " in done.stdout
    printed = re.search(r"^\[(\S+)\] mm by the spheres, (\S+) mm in the run$", done.stdout, re.MULTILINE)
    assert printed is not None
    by_spheres, in_run = (f"{float(number):.2f} mm" for number in printed.groups())
    assert f"gives {by_spheres} and the run {in_run}" in read_page(page)


def test_the_case_ends_at_the_target_within_the_limit(finished: MiniRun) -> None:
    outcome = finished.outcome
    assert outcome["outcome"] == "done"
    assert len(outcome["targets"]) == 1
    assert 0.0 < outcome["max_application_error_mm"] <= LARGEST_ERROR_MM
    assert outcome["ct"]["found"] == 3
    assert (outcome["ct"]["missed"], outcome["ct"]["false"]) == (0, 0)


def test_the_json_has_exactly_the_documented_keys(finished: MiniRun) -> None:
    assert list(finished.outcome) == [
        "run", "outcome", "seed", "strategy", "localizer", "matcher", "markers", "ct", "registration",
        "targets", "mean_application_error_mm", "max_application_error_mm", "late_cycles", "sim_s", "wall_s",
        "report",
    ]  # fmt: skip
    assert list(finished.outcome["targets"][0]) == [
        "id", "depth_mm", "predicted_tre_mm", "application_error_mm", "strategy",
    ]  # fmt: skip
    assert list(finished.outcome["ct"]) == ["found", "missed", "false", "rms_error_mm"]


def test_the_run_creates_one_folder_and_nothing_else(finished: MiniRun) -> None:
    assert [entry.name for entry in finished.out.iterdir()] == [finished.folder.name]


def test_only_the_owner_can_read_the_run(finished: MiniRun) -> None:
    for path in (finished.folder, *finished.folder.rglob("*")):
        assert (path, path.stat().st_mode & 0o077) == (path, 0)


def test_every_result_is_a_record_whose_parents_exist(finished: MiniRun) -> None:
    records = records_of(finished.folder)
    known = {record.identifier for record in records}
    assert len(records) == 17
    for record in records:
        assert set(record.parents) <= known
        assert record.parents or record.kind in ("ct_import", "set_up")


@pytest.mark.hazard(47)
def test_the_tracker_sees_the_mounted_guide_near_its_recorded_place(finished: MiniRun) -> None:
    (checked,) = (one.payload for one in records_of(finished.folder) if one.kind == "tool_check")
    assert 0.0 < checked["seen_off_mm"] < TRACKER_MM


def test_the_journal_is_complete_and_has_an_intent_before_every_result(finished: MiniRun) -> None:
    lines = list(read_journal(finished.folder / JOURNAL_FILE))
    steps = [(line["entry"], line["step"]) for line in lines if line["entry"] in ("intent", "result")]
    assert steps[0::2] == [("intent", step) for _, step in steps[1::2]]
    assert (lines[0]["entry"], lines[-1]["entry"]) == ("opened", "closed")


@pytest.mark.hazard(35)
def test_the_log_has_neither_the_name_nor_the_number_of_the_patient(finished: MiniRun) -> None:
    header = pydicom.dcmread(next(finished.folder.rglob("*.dcm")), stop_before_pixels=True)
    text = "".join(path.read_text() for path in finished.folder.glob("log.jsonl*"))
    assert "step done" in text
    for secret in (header.PatientName.family_name, header.PatientID):
        assert secret
        # As a word of its own: simulated calibrations are named after the scene, as the patient is.
        assert not re.search(rf"(?<![\w-]){re.escape(secret)}\b", text)


@pytest.mark.hazard(36)
def test_every_motion_to_be_confirmed_is_described_with_its_length_speed_and_clearance(
    finished: MiniRun,
) -> None:
    lines = [line for line in read_journal(finished.folder / JOURNAL_FILE) if line["entry"] == "confirmation"]
    asked = {line["topic"]: str(line["value"]) for line in lines}
    for topic in ("first_motion", "approach:T1", "retreat:T1", "park"):
        assert ("a yes also covers every later motion " in asked[topic]) is (topic == "first_motion")
        stated = FACTS.fullmatch(asked[topic])
        assert stated, (topic, asked[topic])
        assert "head" in f"{stated[2]}{stated[3]}"
    assert re.search(r"^then: \d+ mm$", asked["approach:T1"], re.MULTILINE)  # along the axis
    topics = [*asked]
    assert topics.index("approach:T1") < topics.index("at_target:T1") < topics.index("retreat:T1")


def test_the_bytes_of_every_link_are_kept_in_both_directions(finished: MiniRun) -> None:
    folder = finished.folder / BYTES_FOLDER
    links = {"tracker", "robot.master.eki", "robot.master.rsi"}
    cameras = {f"stereo.{side}.{part}" for side in ("left", "right") for part in ("control", "stream")}
    assert set(list_links(folder)) == links | cameras
    for link in (*links, "stereo.left.control", "stereo.right.control"):
        assert {line.direction for line in read_link(folder, link)} >= set(Direction), link
    images = [line.note for line in read_link(folder, "stereo.left.stream")]
    assert images
    assert all(note["missing_packets"] == 0 for note in images)


def test_the_arms_of_the_studies_place_the_spheres_where_the_case_recorded_them(finished: MiniRun) -> None:
    results = {record.kind: record.payload for record in records_of(finished.folder)}
    scene = read_scene(finished.folder / "theatre" / "scene.json")
    arms = RandomArms.of([(scene.arm, scene.mount.flange_from_tool_true.translation_mm - TOOL_MM)])
    ct_mm = np.array([one.centre_ct_mm for one in spheres_in_theatre(scene)])
    markers_mm = np.array([marker["centre_mm"] for marker in results["fiducial_localization"]["markers"]])
    found = results["relocalization"]
    nearest = cdist(markers_mm[found["fiducials"]], ct_mm).argmin(axis=1)
    spheres_mm = apply(matrix_of(scene.head.robot_from_ct), ct_mm[nearest])
    planned = PlannedPoses.of(ARM, TOOL_MM, np.array(found["joints_rad"]))
    sides = np.array(results["path_check"]["targets"]["T1"]["approach_signs"], dtype=float)
    _, believed_mm = centre_on_spheres(arms, planned, spheres_mm, np.tile(sides, (1, len(spheres_mm), 1)))
    recorded_mm = np.array(found["points_robot_mm"])
    assert np.abs(recorded_mm - spheres_mm).max() > 1.0  # so wrong is the nominal arm about its tool
    assert np.abs(recorded_mm - believed_mm[0]).max() < WIRES_APART_MM


def test_the_arms_of_the_studies_err_at_the_target_as_the_case_did(finished: MiniRun) -> None:
    results = {record.kind: record.payload for record in records_of(finished.folder)}
    scene = read_scene(finished.folder / "theatre" / "scene.json")
    target_ct_mm = np.array(results["plan_check"]["plan"]["trajectories"][0]["target_mm"])
    registered = FramedPose.model_validate_json(
        json.dumps(results["registration"]["robot_from_ct"])
    ).transform
    held = FramedPose.model_validate_json(json.dumps(results["positioning"]["tool_pose"])).transform
    instrument_mm = held.inverse().apply(registered.apply(target_ct_mm))  # on the guide's axis
    tip = matrix_of(scene.mount.flange_from_tool_true) @ matrix_of(scene.mount.tool_from_tip_true)
    arms = RandomArms.of([(scene.arm, apply(tip, instrument_mm) - TOOL_MM)])
    sides = np.array([[results["path_check"]["targets"]["T1"]["approach_signs"]]], dtype=float)
    (reached_mm,) = arms.tool_points_mm(np.array([[results["positioning"]["joints_rad"]]]), sides)[0]
    apart_mm = np.linalg.norm(reached_mm - apply(matrix_of(scene.head.robot_from_ct), target_ct_mm))
    assert abs(apart_mm - finished.outcome["targets"][0]["application_error_mm"]) < WIRES_APART_MM


def test_replaying_the_readings_reproduces_every_result(finished: MiniRun) -> None:
    before = {path: path.stat().st_mtime_ns for path in finished.folder.rglob("*")}
    done = in_this_process(ronna_procedure, "replay", finished.folder, "--json")
    assert done.returncode == 0, done.stderr
    records = json.loads(done.stdout)["records"]
    assert [one["record"] for one in records] == [one.identifier for one in records_of(finished.folder)]
    assert {one["verdict"] for one in records} == {"equal"}
    assert {path: path.stat().st_mtime_ns for path in finished.folder.rglob("*")} == before


@pytest.mark.slow
def test_replay_confirms_every_result_on_another_kind_of_processor(
    finished: MiniRun, shared_commands: Commands, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(shared_commands.environment, "OPENBLAS_CORETYPE", "Prescott")  # of 2004
    done = shared_commands.run("ronna-procedure", "replay", str(finished.folder), "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["different"] == json.loads(done.stdout)["not_recorded"] == 0


@pytest.mark.slow
def test_replay_detects_an_edited_reading_in_the_results_computed_from_it(
    finished: MiniRun, tmp_path: Path
) -> None:
    copy = tmp_path / finished.folder.name
    shutil.copytree(finished.folder, copy)
    readings = copy / "readings" / "readings.jsonl"
    lines = readings.read_text().splitlines()
    frames = [number for number, line in enumerate(lines) if '"call":"read_frame"' in line]
    before = ROOM_FRAMES + 2 * FRAMES  # while the head is clamped, and before and after the cart is leaned on
    place = frames[before + 10]  # of the sixty that are averaged before the first path is checked
    edited = json.loads(lines[place])
    edited["answer"]["strays"][0]["position_mm"][0] += 0.001
    lines[place] = json.dumps(edited)
    readings.write_text("\n".join(lines))
    done = in_this_process(ronna_procedure, "replay", copy, "--json")
    assert done.returncode == 1
    assert "PRO-025" in done.stderr
    verdicts = {one["step"]: one["verdict"] for one in json.loads(done.stdout)["records"]}
    assert verdicts["set_up"] == "equal"
    assert verdicts["global_localization"] == verdicts["path_check"] == "different"


def test_a_run_killed_after_its_last_line_gets_its_report_and_seal_on_resume(
    finished: MiniRun, tmp_path: Path
) -> None:
    copy = tmp_path / finished.folder.name
    shutil.copytree(finished.folder, copy, ignore=shutil.ignore_patterns("report*", "seal.json"))
    resumed = in_this_process(ronna_procedure, "resume", copy, "--accept", "--json")
    assert json.loads(resumed.stdout)["targets"] == finished.outcome["targets"]
    assert Path(json.loads(resumed.stdout)["report"]).exists()
    assert inspect_run(copy).problems == ()


@pytest.mark.hazard(31)
def test_the_report_is_self_contained_and_marked_as_simulated_and_no_medical_device(
    finished: MiniRun,
) -> None:
    report = Path(finished.outcome["report"]).read_text()
    assert not re.search(r"(src|href)=[\"'](?!data:)", report)
    assert report.count("data:image/png;base64,") >= 4
    assert "SIMULATED THEATRE" in report
    assert "not a medical device" in report
    assert re.search(
        r"Markers in the CT: \S+ s here, on (?!a processor that was not).+; in the thesis \(5\.1\) 191\.5 s "
        r"by an operator, 28\.8 s by its algorithm on an? \S+",
        report,
    )


@pytest.mark.hazard(6)
def test_the_report_shows_the_figures_of_the_records_and_of_the_verifier(finished: MiniRun) -> None:
    shown = figures_in(Path(finished.outcome["report"]))
    assert len(shown) == 1
    assert shown == figures_of_records(finished.folder)


SIGNALS = (SIGINT, SIGTERM, SIGHUP)


@pytest.fixture(
    scope="module",
    params=[None, *(pytest.param(one, marks=pytest.mark.slow, id=one.name) for one in SIGNALS)],
)
def interrupted(
    request: pytest.FixtureRequest,
    shared_commands: Commands,
    tmp_path_factory: pytest.TempPathFactory,
    hang_ups_count: None,
) -> tuple[Path, str]:
    """A run of the same case that was ended when the arm was on its way to the target, and what it said.

    By a signal, or by somebody who types Ctrl-C until it ends.
    """

    def interrupt(out: Path) -> str:
        if request.param is None:
            said = _typed(out)
        else:
            process = shared_commands.start("ronna-procedure", *MINI_SEED_7, "--out", str(out))
            await_motion_in(out, MOVING)
            process.send_signal(request.param)
            _, said = process.communicate(timeout=HANG_LIMIT_S)
            assert process.returncode == 130, said
        assert shared_commands.await_no_survivors() == []
        assert_nothing_half_written(out)
        return said

    def _typed(out: Path) -> str:
        terminal = Terminal(shared_commands, *MINI_SEED_7[:-1], "--out", str(out))  # `--json` is for scripts
        try:
            terminal.read_until(lambda: moved_in(out, MOVING))
            terminal.end_by_ctrl_c()
        finally:
            terminal.close()
        return terminal.text

    out, said = made_once(tmp_path_factory, f"interrupted-{request.param}", interrupt)
    run = run_folder(out)
    assert run is not None
    return run, said


@pytest.mark.hazard(4)
def test_a_case_interrupted_while_the_arm_moves_is_closed_and_can_be_resumed(
    interrupted: tuple[Path, str],
) -> None:
    run, said = interrupted
    inspect_run(run).require_whole()
    lines = list(read_journal(run / JOURNAL_FILE))
    assert [line["entry"] for line in lines[-2:]] == ["interrupted", "closed"]
    assert "ronna-procedure resume " in said
    assert "Traceback" not in said


def test_the_report_of_an_interrupted_run_says_so(interrupted: tuple[Path, str]) -> None:
    text = (interrupted[0] / "report.html").read_text()
    assert f"It was interrupted during {MOVING}." in text
    assert "predicted limit mm" in text


def test_the_same_seed_gives_the_same_results_bit_for_bit(
    finished: MiniRun, interrupted: tuple[Path, str]
) -> None:
    runs = (interrupted[0], finished.folder)
    again, results = ({r.kind: r.payload for r in records_of(run)} for run in runs)
    assert {kind for kind, result in again.items() if result == results[kind]} - DATED == MEASURED


def test_the_verifier_alone_reports_the_same_errors(finished: MiniRun) -> None:
    checked = in_this_process(ronna_sim, "verify", finished.folder, "--json")
    errors = [row["application_error_mm"] for row in json.loads(checked.stdout)["targets"]]
    assert errors == [row["application_error_mm"] for row in finished.outcome["targets"]]


@pytest.mark.slow
@pytest.mark.timeout(300)
def test_a_case_runs_with_a_polaris_vega(commands: Commands, tmp_path: Path) -> None:
    printed = commands.run("ronna-sim", "scene", "--scene", "mini", "--seed", "7", "--tracker", "vega")
    (tmp_path / "vega.toml").write_text(printed.stdout)
    ran = SimulatedCase(commands, tmp_path).run("--scene", str(tmp_path / "vega.toml"))
    assert ran.returncode == 0, ran.stderr
    run = MiniRun(tmp_path / "runs", ran.stdout)
    (set_up,) = (one for one in records_of(run.folder) if one.kind == "set_up")
    assert "Polaris Vega ST" in json.dumps(set_up.payload)
    (target,) = run.outcome["targets"]
    assert target["application_error_mm"] < LARGEST_ERROR_MM
