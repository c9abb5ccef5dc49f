"""`ronna-ct postoperative` as a user runs it: the wrong folders, and a case verified afterwards."""

from __future__ import annotations

import json
from pathlib import Path

import pydicom
import pytest
from clinical_case import ClinicalCell
from painted_ct import Scan, write_series
from prepared_results import checked_plan, imported_ct
from spoiled_slices import every, setting
from user_commands import Commands, in_this_process

from procedures.cli.ct import app
from procedures.planning.plan_file import read_plan

PLAN = """schema = 1
series_instance_uid = "{uid}"
patient_orientation = "HFS"
implanted = 4
fiducials = "free"
tool = "guide"
standoff_mm = 30.0
instrument_length_mm = 250.0
[[trajectories]]
id = "T1"
entry_mm = [20.0, 0.0, 40.0]
target_mm = [20.0, 0.0, 20.0]
margin_mm = 1.0
"""


def _series(folder: Path, uid: str, patient: str = "") -> Path:
    """A scan of air under one name."""
    scan = Scan(shape=(12, 16, 16), noise_hu=5.0)
    edit = every(setting(SeriesInstanceUID=uid, PatientID=patient))
    return write_series(folder, scan.voxels(), scan.spacing_mm, edit=edit)


def _plan(folder: Path, uid: str) -> Path:
    path = folder / "plan.toml"
    path.write_text(PLAN.format(uid=uid))
    return path


@pytest.mark.parametrize(
    ("series", "planned", "code", "exit_code"),
    [
        (("1.2.1", "1.2.2"), "1.2.2", "POST-003", 1),  # exchanged
        (("1.2.1", "1.2.1"), "1.2.1", "POST-004", 1),
        (("1.2.1", "1.2.2"), "1.2.3", "PLAN-003", 1),
        (("1.2.1", "1.2.2"), "1.2.1", "POST-001", 1),  # nothing but air
    ],
)
def test_the_wrong_series_are_refused(
    tmp_path: Path, series: tuple[str, str], planned: str, code: str, exit_code: int
) -> None:
    folders = [_series(tmp_path / name, uid) for name, uid in zip(("pre", "post"), series, strict=True)]
    done = in_this_process(app, "postoperative", *folders, "--plan", _plan(tmp_path, planned))
    assert (done.returncode, done.stdout) == (exit_code, "")
    assert code in done.stderr


@pytest.mark.hazard(43)
def test_the_ct_of_another_patient_is_refused_without_naming_anybody(tmp_path: Path) -> None:
    pre = _series(tmp_path / "pre", "1.2.1", "ALICE-1")
    post = _series(tmp_path / "post", "1.2.2", "BOB-2")
    done = in_this_process(app, "postoperative", pre, post, "--plan", _plan(tmp_path, "1.2.1"))
    assert done.returncode == 3
    assert "POST-005" in done.stderr
    assert "ALICE" not in done.stderr + done.stdout
    assert "BOB" not in done.stderr + done.stdout


def test_a_series_that_is_not_ct_and_a_trajectory_not_in_the_plan_are_refused(tmp_path: Path) -> None:
    pre, plan = _series(tmp_path / "pre", "1.2.1"), _plan(tmp_path, "1.2.1")
    scan = Scan(shape=(12, 16, 16), noise_hu=5.0)
    edit = every(setting(SeriesInstanceUID="1.2.2", Modality="MR"))
    post = write_series(tmp_path / "mr", scan.voxels(), scan.spacing_mm, edit=edit)
    assert "CT-004" in in_this_process(app, "postoperative", pre, post, "--plan", plan).stderr
    other = in_this_process(app, "postoperative", pre, post, "--plan", plan, "--only", "T9")
    assert other.returncode == 2
    assert "T9" in other.stderr


@pytest.mark.hazard(43)
@pytest.mark.parametrize(
    ("done", "now", "refused"),
    [
        ("", "", ("POST-001",)),  # the CTs are looked at
        ("target_mm = [20.0, 0.0, 20.0]", "target_mm = [20.0, 0.0, 21.0]", ("POST-008", "in trajectories")),
        ('"1.2.1"', '"1.2.3"', ("POST-008", "in series_instance_uid")),
    ],
)
def test_a_run_that_followed_another_plan_does_not_get_the_result(
    tmp_path: Path, done: str, now: str, refused: tuple[str, ...]
) -> None:
    pre, post = _series(tmp_path / "pre", "1.2.1"), _series(tmp_path / "post", "1.2.2")
    plan = _plan(tmp_path, "1.2.1")
    followed = tmp_path / "followed.toml"
    followed.write_text(plan.read_text().replace(done, now))
    cell = ClinicalCell(tmp_path / "run")
    checked = checked_plan().model_copy(update={"plan": read_plan(followed)})
    engine = cell.begin(imported_ct().model_copy(update={"series_instance_uid": "1.2.1"}), checked)
    engine.run_to()
    engine.close("done")
    given = in_this_process(app, "postoperative", pre, post, "--plan", plan, "--run", cell.folder)
    assert [words for words in refused if words not in given.stderr] == []
    assert not (cell.folder / "report").exists()


@pytest.mark.slow
@pytest.mark.timeout(170)
def test_the_achieved_target_error_of_a_case_is_measured_and_shown_in_its_report(
    commands: Commands, tmp_path: Path
) -> None:
    done = commands.run(
        *("ronna-procedure", "run", "--sim", "--scene", "mini", "--seed", "3"),
        *("--out", str(tmp_path / "runs"), "--json"),
    )
    reached = json.loads(done.stdout)
    run = tmp_path / "runs" / reached["run"]
    commands.run("ronna-sim", "phantom", "--postoperative", str(run), "--out", str(tmp_path / "post"))
    words = ("ronna-ct", "postoperative", str(run / "case/ct"), str(tmp_path / "post/ct"))
    plan = ("--plan", str(run / "case/plan.toml"))
    more = ("--run", str(run), "--out", str(tmp_path / "proof"), "--json")
    done = commands.run(*words, *plan, *more)
    assert done.returncode == 0, done.stderr
    (found,) = json.loads(done.stdout)["trajectories"]
    truth_mm = reached["targets"][0]["application_error_mm"]
    assert found["target_error_mm"] == pytest.approx(truth_mm, abs=0.2)
    assert found["angle_deg"] < 0.5
    assert "After the operation" in (run / "report.html").read_text()
    assert commands.run("ronna-procedure", "verify", str(run)).returncode == 0
    assert commands.run("ronna-procedure", "report", str(run)).returncode == 0
    assert "After the operation" in (run / "report.html").read_text()  # it was kept
    registration = pydicom.dcmread(tmp_path / "proof" / "postoperative-registration.dcm")
    points = pydicom.dcmread(tmp_path / "proof" / "postoperative-points.dcm")
    assert registration.PatientID == points.PatientID == ""
    assert len(registration.RegistrationSequence) == 2
    assert len(points.FiducialSetSequence[0].FiducialSequence) == 4
