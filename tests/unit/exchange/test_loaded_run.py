"""A run as arrays: what loads, what is left out and said, and what is refused in one sentence."""

from __future__ import annotations

import json
import os
import sys
from contextlib import nullcontext
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from declaration_checks import UNITS
from prepared_results import checked_plan, imported_ct, localized_fiducials, registered_robot, relocalization

import procedures.imaging
import procedures.registration
import procedures.relocalization
import ronna_hw
from procedures.cli.planning_inputs import read_assumed_pose
from procedures.engine.case import Case, StepKey
from procedures.engine.errors import EVENTS_UNREADABLE
from procedures.engine.replay.recorded_answers import section_follower
from procedures.exchange import recorded_tables, run_tables
from procedures.exchange.errors import NO_REGISTRATION, NoSuchLook
from procedures.journal.journal import Entry, Journal
from procedures.runs.folders import hold_run, new_run_folder
from procedures.runs.loaded_run import MOST_SHOWN
from procedures.runs.request import CaseProcedure, RunRequest, SceneChoice
from procedures.runs.request_file import request_hash
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from ronna_hw import RunTable, RunWarning, load_run, track_strays
from ronna_hw.arguments import WrongArgument
from ronna_hw.arm.pose import Pose
from ronna_hw.command_line.errors import PATH_PROBLEM
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.devices.readings import (
    AreaOfInterest,
    CameraImage,
    Stamp,
    StereoReading,
    StrayReading,
    TrackerFrame,
    Validity,
)
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.journal_reading import RUN_CHANGED
from ronna_hw.evidence.lost_journal_end import EVENTS_FILE
from ronna_hw.evidence.manifest import KEPT_TRUTH, REQUEST_FILE, seal, sha256_of
from ronna_hw.loaded_run import NO_PANDAS, NO_RUN_READER, RunColumn
from ronna_hw.recording.reading_tape import PIXELS_FILE, READINGS_FILE, READINGS_FOLDER, ReadingTape
from ronna_hw.records import OTHER_VERSION

STAMP = Stamp(1, 4242, 1.25)
LEFT = CameraImage(
    STAMP, Validity.OK, "L1", np.arange(1200, dtype=np.uint16).reshape(30, 40), AreaOfInterest(16, 32, 40, 30)
)
PAIR = StereoReading(STAMP, Validity.PARTIAL, LEFT, None)
TABLES = {
    name: table
    for module in (run_tables, recorded_tables)
    for name, table in vars(module).items()
    if isinstance(table, tuple) and table and isinstance(table[0], RunColumn)
}
WITHOUT_UNIT = {"confidence", "quality", "odds"}


def frame(
    number: int, *strays_mm: tuple[float, float, float], validity: Validity = Validity.OK
) -> TrackerFrame:
    stamp = Stamp(number, 100 + number, number / 60.0)
    return TrackerFrame(stamp, validity, (), tuple(StrayReading(one, Validity.OK) for one in strays_mm))


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run that goes on: results up to the registration of T1, frames and a look, the arm under way."""
    folder = tmp_path / "runs" / "20261126T000000-s7-0000"
    folder.mkdir(parents=True)
    tape = ReadingTape(folder / READINGS_FOLDER, lambda: 3.5, {"paced": True})
    case, journal = Case(folder), Journal(folder, section_follower(tape))
    journal.write(Entry.OPENED, 0.0, run=folder.name)
    journal.write(Entry.INTENT, 0.0, step="global_localization")
    a, b = (0.0, 0.0, -1500.0), (0.0, 40.0, -1500.0)
    for one in (frame(0, a, b), frame(1, b, a), frame(1, b, a, validity=Validity.STALE), frame(2, b)):
        tape.keep("tracker", "read_frame", Lifecycle.ACTIVE, one)
    tape.keep("stereo", "grab_pair", Lifecycle.ACTIVE, PAIR)
    journal.write(Entry.MOTION, 1.0, arm="master", number=1, what="go", to=[0.1] * 6, trajectory=None)
    journal.write(Entry.MOVED, 2.0, arm="master", number=1, joints_rad=[0.1] * 6, at_home=False)
    journal.write(Entry.MOTION, 3.0, arm="master", number=2, what="line", to=[1.0, 2.0, 3.0], trajectory=None)
    journal.write(Entry.MOVED, 3.5, arm="master", number=2, error="RSI-012", at_home=None)
    tape.close()
    results = {
        StepKey("ct_import"): imported_ct(),
        StepKey("fiducial_localization"): localized_fiducials(),
        StepKey("plan_check"): checked_plan(),
        StepKey("relocalization", "T1"): relocalization(),
        StepKey("registration", "T1"): registered_robot(),
    }
    for key, result in results.items():
        stored = case.store(key, result, ())
        names = {"record": stored.record.identifier, "sha256": stored.record.sha256}
        journal.write(Entry.RESULT, 4.0, step=str(key), supersedes=[], **names)
        case.accept(key, stored)
    journal.write(Entry.MOTION, 5.0, arm="master", number=3, what="home", to=[0.0] * 6, trajectory=None)
    journal.close()
    return folder


def test_a_run_that_goes_on_loads_as_far_as_it_is(run: Path) -> None:
    loaded = load_run(str(run))
    with hold_run(run):
        assert loaded.outcome == "running"
    assert loaded.outcome == "killed"
    assert any("still running" in note for note in loaded.notes)
    targets = loaded.targets
    assert targets.name.tolist() == [one.id for one in checked_plan().plan.trajectories]
    assert np.isfinite(targets.predicted_mm[targets.name == "T1"]).all()
    assert np.isnan(targets.error_mm).all()
    assert np.isnan(targets.reached_ct_mm).all()
    np.testing.assert_allclose(loaded.spheres.centre_ct_mm, localized_fiducials().centres_mm)
    np.testing.assert_allclose(loaded.localized.centre_robot_mm, relocalization().points_mm)
    assert set(loaded.localized.step) == {"relocalization:T1"}
    row = targets[targets.name == "T1"][0]
    np.testing.assert_allclose(loaded.robot_from_ct("T1").apply(row.target_ct_mm), row.target_robot_mm)
    assert loaded.registrations.standing.tolist() == [True]
    # Prepared without relocalization as its parent: nothing says what it was weighted with.
    assert np.isnan(loaded.localized.total_covariance_robot_mm2).all()
    assert not loaded.localized.axis.any()  # nor in which paths it was


def test_a_run_tells_with_what_it_was_begun_and_why_it_is_not_done(tmp_path: Path) -> None:
    script = tmp_path / "faults.txt"
    script.write_text("# hide one\nat 2 s: tracker occlude marker 2 for 2 s  # briefly\n\n")
    asked = RunRequest(procedure=CaseProcedure(strategy="nos"), choice=SceneChoice("mini", 7), faults=script)
    folder = new_run_folder(asked, tmp_path / "runs")
    script.unlink()
    journal = Journal(folder)
    opening = {"run": folder.name, "seed": 7, "strategy": "nos", **request_hash(folder)}
    journal.write(Entry.OPENED, 0.0, **opening)
    journal.write(Entry.FAILED, 3.0, step="correspondence", code="REG-013", what="REG-013: no match")
    files = {REQUEST_FILE: sha256_of(folder / REQUEST_FILE)}
    journal.write(Entry.CLOSED, 3.0, outcome="failed", files=files)
    journal.close()
    loaded = load_run(folder)
    assert (loaded.scene, loaded.seed, loaded.strategy) == ("mini", 7, "nos")
    assert loaded.faults == ("at 2 s: tracker occlude marker 2 for 2 s",)
    assert loaded.reason == "correspondence failed. REG-013: no match"
    assert loaded.reason in repr(loaded)


def test_the_assumed_pose_of_the_ct_is_that_of_the_registration(run: Path) -> None:
    plan = checked_plan().plan
    robot_from_ct = registered_robot().robot_from_ct
    found = Pose.from_kuka(*read_assumed_pose(run, plan))
    assert found.position_mm == pytest.approx(robot_from_ct.translation_mm)
    expected = Pose.from_quaternion((0.0, 0.0, 0.0), robot_from_ct.quaternion_wxyz).rotation
    assert found.rotation == pytest.approx(expected, abs=1e-9)


def test_strays_have_an_identity_and_repeated_frames_are_left_out(run: Path) -> None:
    strays = load_run(run).strays
    assert strays.identity.tolist() == [0, 1, 1, 0, 1]
    assert strays.position_tracker_mm[strays.identity == 1].tolist() == [[0.0, 40.0, -1500.0]] * 3
    with pytest.raises(WrongArgument, match=r"got RunRow. .*run\.strays\.identity"):
        track_strays(strays)
    assert strays.device_clock.tolist() == [100, 100, 101, 101, 102]
    assert set(strays.step) == {"global_localization"}


def test_looks_have_their_pictures_and_none_for_a_side_that_did_not_arrive(run: Path) -> None:
    loaded = load_run(run)
    assert loaded.looks.left_offset_px.tolist() == [[16, 32]]
    assert loaded.looks.validity.tolist() == ["partial"]
    (pair,) = loaded.pictures
    np.testing.assert_array_equal(pair.left, LEFT.pixels)
    assert pair.right is None
    assert len(loaded.pictures[:0]) == 0
    assert len(list(loaded.pictures)) == 1
    with pytest.raises(NoSuchLook, match="no look 7; expected 0 to 0"):
        loaded.pictures[7]
    with pytest.raises(WrongArgument, match=r"ARG-001.*'left'"):
        loaded.pictures["left"]  # type: ignore[call-overload]  # wrong on purpose
    with pytest.raises(NoSuchLook, match=r"no pictures.*run\.notes"):
        loaded.pictures[:0][0]


def test_a_motion_tells_how_it_ended_or_that_nothing_is_known_of_its_end(run: Path) -> None:
    motions = load_run(run).motions
    assert motions.kind.tolist() == ["go", "line", "home"]
    assert motions.error.tolist() == ["", "RSI-012", ""]
    assert np.isnan(motions.end_s).tolist() == [False, False, True]
    assert motions.joints_rad[0].tolist() == [0.1] * 6
    assert motions.goal_robot_mm[1].tolist() == [1.0, 2.0, 3.0]
    assert np.isnan(motions.joints_rad[1:]).all()


def test_damaged_readings_alone_are_left_out_and_reading_the_table_warns(run: Path) -> None:
    (run / READINGS_FOLDER / PIXELS_FILE).write_bytes(b"")  # of a running case they may not be there yet
    loaded = load_run(run)
    with pytest.warns(RunWarning, match="1 damaged reading left out; the first: PRO-024") as warned:
        assert len(loaded.looks) == 0
    assert warned[0].filename == __file__
    assert len(loaded.strays) == 5
    (note,) = [note for note in loaded.notes if "PRO-024" in note]
    assert "INP-001" not in note
    assert note in repr(loaded)


@pytest.mark.parametrize("name", [READINGS_FILE, PIXELS_FILE])
def test_readings_changed_since_the_seal_are_noted_and_so_is_that_nothing_is_sealed(
    run: Path, name: str
) -> None:
    assert any(note.startswith("seal.json: missing") for note in load_run(run).notes)
    seal(run, {})
    path = run / READINGS_FOLDER / name
    for content, is_changed in ((path.read_bytes(), False), (path.read_bytes() + b"\n", True)):
        path.write_bytes(content)
        with pytest.warns(RunWarning, match=f"{name}: changed") if is_changed else nullcontext():
            loaded = load_run(run)
        assert len(loaded.strays) == 5
        assert (f"{READINGS_FOLDER}/{name}: changed" in loaded.notes) == is_changed
        assert (f"{name}: changed" in repr(loaded)) == is_changed
        assert not any("seal" in note for note in loaded.notes)


def test_a_damaged_line_of_the_events_is_refused_and_spares_the_other_tables(run: Path) -> None:
    (run / EVENTS_FILE).write_text('{"version": 1, \n')
    loaded = load_run(run)
    with raises(EVENTS_UNREADABLE, match=r"line 1 of .* is not JSON.*was changed"):
        _ = loaded.events
    assert len(loaded.strays) == 5


def test_a_pipe_in_place_of_a_file_and_a_damaged_last_reading_are_noted(run: Path) -> None:
    os.mkfifo(run / EVENTS_FILE)
    with (run / READINGS_FOLDER / READINGS_FILE).open("ab") as tape:
        tape.write(b"[" * 200_000)
    loaded = load_run(run)
    with pytest.warns(RunWarning, match="the last, is torn"):
        assert (len(loaded.events), len(loaded.strays)) == (0, 5)
    assert f"{EVENTS_FILE}: replaced: not a regular file" in loaded.notes
    assert any("the last, is torn" in note for note in loaded.notes)


def test_an_unknown_column_names_the_nearest(run: Path) -> None:
    targets = load_run(run).targets
    with pytest.raises(AttributeError, match="no column error: did you mean error_mm"):
        targets.error  # noqa: B018 - the access is what raises
    with pytest.raises(WrongArgument, match="no column error: did you mean error_mm"):
        targets["error"]


def test_errors_from_a_changed_truth_are_left_out(run: Path) -> None:
    truth = run / KEPT_TRUTH
    truth.parent.mkdir()
    truth.write_text(json.dumps({"targets": [{"id": "T1", "application_error_mm": 0.25}]}))
    seal(run, {})
    assert load_run(run).targets.error_mm[0] == 0.25
    truth.write_text(truth.read_text().replace("0.25", "0.05"))
    with pytest.warns(RunWarning):
        loaded = load_run(run)
    assert np.isnan(loaded.targets.error_mm[0])
    assert f"{KEPT_TRUTH}: changed" in loaded.notes


def test_a_changed_record_is_refused_and_one_of_another_version_spares_the_other_tables(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with monkeypatch.context() as other:
        other.setattr(LocalizedFiducials, "version", 99)
        loaded = load_run(run)
        with raises(OTHER_VERSION, match="version 99, got version 2"):
            _ = loaded.spheres
        assert len(loaded.strays) == 5
    record = run / "records" / "02-fiducial_localization.json"
    record.write_text(record.read_text().replace('"quality": ', '"quality": 0'))
    with raises(RUN_CHANGED):
        load_run(run)


def test_loading_names_what_verify_names_and_warns(run: Path) -> None:
    for name in ("case/plan.toml", *(f"pictures/{number}.png" for number in range(MOST_SHOWN))):
        (run / name).parent.mkdir(exist_ok=True)
        (run / name).write_text("as sealed")
    seal(run, {})
    (run / "case/plan.toml").write_text("edited")
    for picture in (run / "pictures").iterdir():
        picture.unlink()
    with pytest.warns(RunWarning, match=r"pictures/0.png: missing") as warned:
        loaded = load_run(run)
    assert warned[0].filename == __file__
    assert {str(problem) for problem in inspect_run(run).problems} <= set(loaded.notes)
    assert "case/plan.toml: changed" in loaded.notes
    assert f"{len(loaded.notes) - MOST_SHOWN} more" in repr(loaded)


def test_what_is_no_run_folder_is_refused_with_what_to_give(run: Path, tmp_path: Path) -> None:
    with raises(PATH_PROBLEM, match=run.name):
        load_run(run.parent)  # a folder of runs
    for wrong in (run / "journal.jsonl", tmp_path / "nothing", tmp_path):
        with raises(PATH_PROBLEM):
            load_run(wrong)
    for not_a_path in ("", " ", None, [run], 5, b"run"):
        with pytest.raises(WrongArgument, match=r"got .") as refused:
            load_run(not_a_path)
        assert isinstance(refused.value, TypeError)
    with raises(NO_REGISTRATION, match="no registration for a target 'T9'"):
        load_run(run).robot_from_ct("T9")


def test_a_stale_installation_without_the_reader_says_what_to_run(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("ronna_hw.loaded_run.entry_points", lambda *, group: [])
    with raises(NO_RUN_READER, match="make setup"):
        load_run(run)


def test_a_table_for_pandas_has_a_column_per_component_and_needs_pandas(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = load_run(run)
    table = loaded.localized[loaded.localized.sphere == "M1"].to_pandas()
    assert table["centre_robot_y_mm"].tolist() == [relocalization().points_robot_mm[0][1]]
    assert {"joints_A6_rad", "stereo_covariance_robot_xz_mm2"} <= set(table.columns)
    assert "robot_from_ct_w" in loaded.registrations.to_pandas()
    monkeypatch.setitem(sys.modules, "pandas", None)
    with raises(NO_PANDAS, match="pip install pandas"):
        loaded.targets.to_pandas()


@pytest.mark.parametrize("name", sorted(TABLES))
def test_an_empty_table_has_all_columns_and_each_quantity_has_its_unit(name: str) -> None:
    columns = TABLES[name]
    assert RunTable.of(columns, ()).dtype.names == tuple(one.name for one in columns)
    assert len(RunTable.of(columns, ()).to_pandas()) == 0
    quantities = {one.name for one in columns if one.kind is float} - WITHOUT_UNIT
    assert {one for one in quantities if not one.endswith(UNITS)} == set()


@pytest.mark.parametrize(
    "package", [ronna_hw, procedures.registration, procedures.relocalization, procedures.imaging]
)
def test_completion_shows_the_public_names_of_a_package_and_no_others(package: object) -> None:
    assert dir(package) == sorted(package.__all__)
    assert all(hasattr(package, name) for name in dir(package))


def test_joints_in_a_table_are_as_many_as_the_arm_with_most_axes_has() -> None:
    motion = {"number": 1, "what": "go", "theatre_time_s": 1.0}
    table = run_tables.motions_table(
        [
            {**motion, "entry": Entry.MOTION, "arm": "master", "to": [0.1] * 7},
            {**motion, "entry": Entry.MOVED, "arm": "master", "joints_rad": [0.1] * 7},
            {**motion, "entry": Entry.MOTION, "arm": "assistant", "to": [0.2] * 6},
        ]
    )
    assert table.goal_rad[:, :6].tolist() == [[0.1] * 6, [0.2] * 6]
    assert np.isnan(table.goal_rad[:, 6]).tolist() == [False, True]
    assert table.columns[6].pandas_names[-1] == "goal_A7_rad"
