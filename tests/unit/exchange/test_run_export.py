"""The export of a run: its spheres once, and the last registration of each trajectory."""

from __future__ import annotations

import csv
import hashlib
import json
import math
import re
from fnmatch import fnmatch
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from clinical_case import FIRST, LAST
from coded_errors import raises
from finished_runs import recorded_run
from prepared_results import (
    SERIES,
    learned_arm,
    registered_robot,
)
from pydicom import dcmread
from scanned_head import scanned_spheres
from scipy.spatial.transform import Rotation
from skin_case import IN_CT_MM, registered_by_surface, scanned_surface, skin_in_ct
from whole_run import IMPORTED, IN_CT, PLAN, TOO_DEEP_MM, TRUE, whole_run

from procedures.engine.case import StepKey
from procedures.exchange.allowed_fields import FILES
from procedures.exchange.errors import NOT_WRITABLE, NOTHING_TO_EXPORT, UNKNOWN_FORM
from procedures.exchange.run_export import export_run
from procedures.exchange.sphere_files import check_names
from procedures.reporting.outcome import Truth
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.results import RegisteredRobot
from ronna_hw import load_run
from ronna_hw.evidence.journal_reading import RUN_CHANGED
from ronna_hw.evidence.manifest import RAW_FOLDER, seal
from ronna_hw.frames import Frame, Transform
from ronna_hw.records import OTHER_VERSION


def fit(trajectory: str, x_mm: float) -> RegisteredRobot:
    turn = Rotation.from_rotvec([0.0, 0.0, 0.5]).as_quat(scalar_first=True)
    pose = Transform.of(Frame.ROBOT, Frame.CT, translation_mm=[x_mm, 0.0, 0.0], quaternion_wxyz=turn)
    done = registered_robot(pose)
    return done.model_copy(update={"predictions": (done.prediction(trajectory),)})


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    fits = (("T1", 1.0), ("T2", 2.0), ("T1", 3.0))
    return recorded_run(
        tmp_path / "run", *IN_CT, *((StepKey("registration", name), fit(name, x)) for name, x in fits)
    )


def test_an_export_has_the_spheres_and_the_last_registration_of_each_trajectory(finished: Path) -> None:
    out = finished / "export"
    names = {path.name for path in export_run(finished, out).files}
    assert names == {
        *("export.json", "spheres.csv", "spheres.schema.csv", "spheres.json", "spheres.mrk.json"),
        *("registrations.csv", "registrations.schema.csv", "registrations.json"),
        *("spheres.dcm", "registration-T1.dcm", "registration-T2.dcm"),
        *("structures.dcm", "report-page.dcm"),
    }
    assert (out / "spheres.csv").read_text().splitlines()[1].startswith("M1,1.0,2.0,3.0,0.01")
    said = json.loads((out / "registrations.json").read_text())["registrations"]
    assert [(one["trajectory"], one["robot_from_ct"]["translation_mm"][0]) for one in said] == [
        ("T2", 2.0),
        ("T1", 3.0),
    ]


def test_the_tables_agree_with_the_dicom_objects(finished: Path) -> None:
    out = finished / "export"
    export_run(finished, out)
    spheres = json.loads((out / "spheres.json").read_text())
    assert (spheres["series_instance_uid"], spheres["coordinate_system"]) == (SERIES, "LPS")
    assert [(one["name"], one["centre_mm"]) for one in spheres["spheres"]] == [("M1", [1.0, 2.0, 3.0])]
    assert np.array(spheres["spheres"][0]["covariance_mm2"]).shape == (3, 3)
    rows = list(csv.DictReader((out / "registrations.csv").read_text().splitlines()))
    assert [row["trajectory"] for row in rows] == ["T2", "T1"]
    for row in rows:
        read = dcmread(out / f"registration-{row['trajectory']}.dcm").RegistrationSequence[1]
        step = read.MatrixRegistrationSequence[0].MatrixSequence[0]
        matrix = np.array(step.FrameOfReferenceTransformationMatrix, dtype=float).reshape(4, 4)
        said = [float(row[f"m{i}{j}"]) for i in range(1, 4) for j in range(1, 5)]
        np.testing.assert_allclose(said, matrix[:3].ravel(), atol=1e-12)
        assert float(row["predicted_tre_mm"]) == 0.2


def test_the_registrations_reference_the_exported_spheres(finished: Path) -> None:
    out = finished / "export"
    export_run(finished, out)
    spheres = dcmread(out / "spheres.dcm")
    first, second = (dcmread(out / f"registration-{name}.dcm") for name in ("T1", "T2"))
    used = first.RegistrationSequence[1].UsedFiducialsSequence[0]
    assert used.ReferencedSOPInstanceUID == spheres.SOPInstanceUID
    assert used.FiducialUID == spheres.FiducialSetSequence[0].FiducialSequence[0].FiducialUID
    assert first.FrameOfReferenceUID == second.FrameOfReferenceUID
    assert first.SOPInstanceUID != second.SOPInstanceUID


def test_a_run_without_a_ct_is_refused(tmp_path: Path) -> None:
    run = recorded_run(tmp_path / "run", (StepKey("registration", "T1"), fit("T1", 1.0)))
    with raises(NOTHING_TO_EXPORT, match="EXC-003"):
        export_run(run, tmp_path / "export")


def test_a_run_that_ended_early_is_exported_as_far_as_it_came(tmp_path: Path) -> None:
    run = recorded_run(tmp_path / "run", *IN_CT, (StepKey("plan_check"), PLAN))
    exported = export_run(run, tmp_path / "export")
    index = json.loads((tmp_path / "export" / "export.json").read_text())
    assert {path.name for path in exported.files} == set(index["files"]) | {"export.json"}
    content = {path.name: path.read_bytes() for path in exported.files if path.name in index["files"]}
    assert index["sha256"] == {name: hashlib.sha256(held).hexdigest() for name, held in content.items()}
    assert {"planned.mrk.json", "lines.csv", "errors.csv", "spheres.mrk.json"} < set(index["files"])
    assert index["absent"] == exported.absent
    assert {f"registration of {FIRST}", f"reached line of {LAST}", "found lines"} < set(exported.absent)
    assert {row["state"] for row in rows_of(tmp_path / "export" / "errors.csv")} == {"not reached"}


@pytest.fixture(scope="module")
def exported(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export of a run that has everything."""
    folder = tmp_path_factory.mktemp("whole")
    export_run(whole_run(folder / "run"), folder / "export")
    return folder / "export"


def rows_of(table: Path) -> list[dict[str, str]]:
    return list(csv.DictReader(table.read_text().splitlines()))


def test_what_is_written_is_what_the_reference_page_says(exported: Path) -> None:
    page = Path("docs/reference/export.md").read_text()
    heads = dict(re.findall(r"## Columns of `(.+?)`\n\n(.+?)(?=\n## |\Z)", page, re.S))
    columns = {name: re.findall(r"^\| `(\w+)` \|", rows, re.M) for name, rows in heads.items()}
    tables = [path for path in exported.glob("*.csv") if not path.match("*.schema.csv")]
    assert columns == {path.name: list(rows_of(path)[0]) for path in tables}
    for path in tables:
        schema = rows_of(exported / f"{path.stem}.schema.csv")
        assert [row["columnName"] for row in schema] == columns[path.name]
        for row in rows_of(path):
            numbers = [row[one["columnName"]] for one in schema if one["type"] != "string"]
            assert all(math.isfinite(float(value)) for value in numbers if value)
    (listed,) = re.findall(r"## Files\n\n(.+?)\n## ", page, re.S)
    patterns = re.findall(r"^\| `(.+?)` \|", listed, re.M)
    names = [path.name for path in exported.iterdir()]
    written = {next((one for one in patterns if fnmatch(name, one)), None) for name in names}
    assert written == set(patterns) - {"scan.ply", "scan.vtp"}  # this case has no scan of the skin
    for path in exported.glob("*.json"):
        fields = set(json.loads(path.read_text())) - {"@schema", "markups"}
        assert all(f"| `{name}` |" in page for name in fields), path.name


def test_every_file_says_frame_direction_unit_and_uids(exported: Path) -> None:
    ct = {
        "series_instance_uid": SERIES,
        "frame_of_reference_uid": "1.2.3",
        "study_instance_uid": "1.2.4",
        "coordinate_system": "LPS",
        "unit": "mm",
    }
    directions = {
        "lines.csv": {"ct", "ct <- robot", "ct <- later ct"},
        "errors.csv": {"ct <- robot"},
        "spheres.csv": {"ct"},
        "registrations.csv": {"robot <- ct"},
    }
    for name, expected in directions.items():
        rows = rows_of(exported / name)
        assert all(row.items() >= ct.items() for row in rows)
        assert {row["direction"] for row in rows} == expected
    for path in exported.glob("*.json"):
        assert json.loads(path.read_text()).items() >= ct.items(), path.name


def test_the_lines_are_slicer_markups_from_entry_to_target_or_tip(exported: Path) -> None:
    planned = PLAN.plan.trajectories[0]
    axis = planned.trajectory.axis_ct
    ends = {
        "planned": [[*one.entry_mm, *one.target_mm] for one in PLAN.plan.trajectories],
        "reached": [[*planned.entry_mm, *(np.array(planned.target_mm) + TOO_DEEP_MM * axis)]],
        "found": [[*planned.entry_mm, *np.add(planned.target_mm, (1.0, 0.0, 0.0))]],
    }
    for kind, expected in ends.items():
        content = json.loads((exported / f"{kind}.mrk.json").read_text())
        assert content["@schema"].endswith("/markups-schema-v1.0.3.json#")
        lines = [as_slicer_line(one) for one in content["markups"]]
        np.testing.assert_allclose(lines, expected, atol=1e-6)


def as_slicer_line(markup: dict[str, Any]) -> list[float]:
    """Both ends, as Slicer's schema of markups 1.0.3 has a line."""
    assert (markup["type"], markup["coordinateSystem"], markup["coordinateUnits"]) == ("Line", "LPS", "mm")
    for colour in ("color", "selectedColor"):
        assert len(markup["display"][colour]) == 3
        assert all(0.0 <= one <= 1.0 for one in markup["display"][colour])
    for point in markup["controlPoints"]:
        assert isinstance(point["id"], str)
        assert point["positionStatus"] == "defined"
        assert len(point["position"]) == 3
    first, second = (point["position"] for point in markup["controlPoints"])
    (length,) = markup["measurements"]
    assert (length["name"], length["units"]) == ("length", "mm")
    assert length["value"] == pytest.approx(math.dist(first, second))
    return [*first, *second]


def test_the_errors_are_kept_apart_by_where_they_come_from(exported: Path) -> None:
    first, last = rows_of(exported / "errors.csv")
    figures = ("error", "lateral", "axial")
    said = {
        source: [float(first[f"{source}_{one}_mm"]) for one in figures]
        for source in ("nominal", "found", "simulated")
    }
    assert said["nominal"] == pytest.approx([TOO_DEEP_MM, 0.0, TOO_DEEP_MM], abs=1e-6)
    assert said["found"] == [1.0, 0.8, 0.6]
    assert said["simulated"] == [0.5, 0.3, -0.4]
    assert float(first["predicted_tre_mm"]) == 0.2
    assert (first["state"], last["state"]) == ("reached", "not reached")
    assert last["nominal_error_mm"] == last["simulated_error_mm"] == ""


def test_a_real_theatre_has_no_true_error_even_if_its_folder_names_one(tmp_path: Path) -> None:
    (tmp_path / "run" / "report").mkdir(parents=True)
    (tmp_path / "run" / "report" / "truth.json").write_text(Truth(targets=(TRUE,)).model_dump_json())
    run = recorded_run(tmp_path / "run", *IN_CT, (StepKey("plan_check"), PLAN))
    assert "true errors" in export_run(run, tmp_path / "out").absent
    assert {row["simulated_error_mm"] for row in rows_of(tmp_path / "out" / "errors.csv")} == {""}


@pytest.mark.parametrize("damage", ["changed", "missing"])
def test_a_changed_or_missing_record_is_named_and_nothing_is_exported(finished: Path, damage: str) -> None:
    path = finished / "records" / "04-registration-T2.json"
    path.write_text(path.read_text().replace("0.95", "0.99"))
    if damage == "missing":
        path.unlink()
    with raises(RUN_CHANGED, match=rf"PRO-033: .*04-registration-T2\.json: {damage}"):
        export_run(finished, finished / "export")
    assert not (finished / "export").exists()


def test_a_record_of_another_version_is_not_exported(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RegisteredRobot, "version", 2)
    with raises(OTHER_VERSION, match=r"REC-003.*expected registration version 2, got version 1"):
        export_run(finished, finished / "export")


def test_an_export_path_that_is_a_file_is_refused(finished: Path) -> None:
    (finished.parent / "export").touch()
    with raises(NOT_WRITABLE, match="EXC-002"):
        export_run(finished, finished.parent / "export")


def test_a_registration_of_another_run_does_not_stay_among_the_exported_ones(finished: Path) -> None:
    out = finished.parent / "exported"
    export_run(finished, out)
    export_run(finished, out)
    (out / "registration-T9.dcm").touch()
    with raises(NOT_WRITABLE, match=r"EXC-002.*registration-T9\.dcm"):
        export_run(finished, out)


def test_an_export_replaces_links_instead_of_writing_through_them(finished: Path) -> None:
    out, precious = finished.parent / "exported", finished.parent / "precious"
    names = [path.name for path in export_run(finished, out).files]
    precious.write_text("precious")
    for name in names:
        (out / name).unlink()
        (out / name).symlink_to(precious)
        (out / f".{name}.partial").symlink_to(precious)
    export_run(finished, out)
    assert precious.read_text() == "precious"
    assert not any(path.is_symlink() for path in out.iterdir())


def test_an_unknown_file_format_is_refused() -> None:
    with raises(UNKNOWN_FORM, match=r"EXC-001: cannot tell the format of spheres.xls"):
        check_names([Path("a.csv"), Path("spheres.xls")])


def test_pictures_kept_in_a_run_are_not_exported(finished: Path, tmp_path: Path) -> None:
    pictures = finished / RAW_FOLDER / "pictures"
    pictures.mkdir(parents=True)
    (pictures / "00001-left.png").write_bytes(b"a picture")
    (finished / "readings").mkdir(exist_ok=True)
    closed = json.loads((finished / "journal.jsonl").read_text().splitlines()[-1])["files"]
    seal(finished, closed)
    written = export_run(finished, tmp_path / "export").files
    of_a_scan = {".ply", ".vtp"}
    assert {path.suffix for path in written} == {Path(name).suffix for name in FILES} - of_a_scan
    assert sorted(written) == sorted(path for path in (tmp_path / "export").rglob("*") if path.is_file())
    assert not any(b"a picture" in path.read_bytes() for path in written)


@pytest.mark.hazard(67)
def test_the_head_as_registered_has_one_pose_in_every_file_and_the_learned_correction_a_place_of_its_own(
    tmp_path: Path,
) -> None:
    done, correction_mm = fit(FIRST, 1.0), (1.0, 3.0, -2.0)
    done = done.model_copy(update={"learned": learned_arm(correction_mm)})
    out, key = tmp_path / "export", StepKey("registration", FIRST)
    run = recorded_run(tmp_path / "run", *IN_CT, (StepKey("plan_check"), PLAN), (key, done))
    export_run(run, out)
    matrix, loaded = done.robot_from_ct.transform.as_matrix(), load_run(run)
    (row,) = csv.DictReader((out / "registrations.csv").read_text().splitlines())
    (said,) = json.loads((out / "registrations.json").read_text())["registrations"]
    read = dcmread(out / f"registration-{FIRST}.dcm").RegistrationSequence[1]
    in_dicom = read.MatrixRegistrationSequence[0].MatrixSequence[0].FrameOfReferenceTransformationMatrix
    np.testing.assert_allclose(np.array(in_dicom, dtype=float).reshape(4, 4), matrix, atol=1e-12)
    in_table = [float(row[f"m{i}{j}"]) for i in range(1, 4) for j in range(1, 5)]
    np.testing.assert_allclose(in_table, matrix[:3].ravel(), atol=1e-12)
    np.testing.assert_allclose(said["robot_from_ct"]["translation_mm"], matrix[:3, 3])
    in_ct = loaded.registration(FIRST)
    np.testing.assert_allclose(loaded.robot_from_ct(FIRST).as_matrix(), matrix)
    np.testing.assert_allclose(in_ct.robot_from_ct.as_matrix(), matrix)
    np.testing.assert_allclose(loaded.registrations.robot_from_ct_mm, [matrix[:3, 3]])
    assert tuple(said["correction_mm"]) == correction_mm
    assert tuple(float(row[f"correction_{axis}_mm"]) for axis in "xyz") == correction_mm
    target = loaded.targets[loaded.targets.name == FIRST][0]
    assert tuple(target.correction_robot_mm) == correction_mm
    sent_mm = in_ct.sent_robot_from_ct.apply(target.target_ct_mm)
    np.testing.assert_allclose(sent_mm, in_ct.robot_from_ct.apply(target.target_ct_mm) + correction_mm)
    np.testing.assert_allclose(sent_mm, target.target_robot_mm)


@pytest.mark.hazard(68)
def test_after_a_scan_of_the_clamped_head_its_spheres_are_exported_beside_those_of_the_ct(
    tmp_path: Path,
) -> None:
    out, scanned = tmp_path / "export", scanned_spheres()
    in_ct = IN_CT[1][1]
    assert isinstance(in_ct, LocalizedFiducials)
    results = (
        *IN_CT,
        (StepKey("intraoperative_scan"), scanned),
        (StepKey("registration"), registered_robot()),
    )
    run = recorded_run(tmp_path / "run", *results)
    export_run(run, out)
    rows = list(csv.DictReader((out / "spheres.csv").read_text().splitlines()))
    listed, loaded = json.loads((out / "spheres.json").read_text())["spheres"], load_run(run)
    points = dcmread(out / "spheres.dcm").FiducialSetSequence[0].FiducialSequence
    assert len(rows) == len(listed) == len(points) == len(loaded.spheres) == len(scanned.shown)
    used_mm, place_mm = scanned.markers[0].centre_mm, in_ct.markers[0].centre_mm
    assert tuple(float(rows[0][name]) for name in ("L_mm", "P_mm", "S_mm")) == used_mm
    assert tuple(float(rows[0][f"planning_ct_{axis}_mm"]) for axis in "LPS") == place_mm
    assert (tuple(listed[0]["centre_mm"]), tuple(listed[0]["planning_ct_mm"])) == (used_mm, place_mm)
    np.testing.assert_allclose(np.array(points[0].ContourData, dtype=float), used_mm)
    for table, column in (
        (loaded.spheres, "centre_ct_mm"),
        (loaded.registration(FIRST).spheres, "expected_ct_mm"),
    ):
        np.testing.assert_allclose(table[column][0], used_mm)
        np.testing.assert_allclose(table.planning_ct_mm[0], place_mm)
        assert np.isnan(table.planning_ct_mm[len(in_ct.markers)]).all()  # new since the CT
    assert rows[len(in_ct.markers)]["planning_ct_L_mm"] == ""
    used = dcmread(out / "registration-all.dcm").RegistrationSequence[1].UsedFiducialsSequence[0]
    assert used.ReferencedSOPInstanceUID == dcmread(out / "spheres.dcm").SOPInstanceUID


def test_a_scan_without_a_registration_is_absent_with_the_reason(tmp_path: Path) -> None:
    run = recorded_run(
        tmp_path / "run",
        (StepKey("ct_import"), IMPORTED),
        (StepKey("skin_in_ct"), skin_in_ct()),
        (StepKey("surface_scan"), scanned_surface()),
        linked=True,
    )
    absent = export_run(run, tmp_path / "out", with_scan=True).absent
    assert absent["scan of the skin"] == "there is no registration that carries it into the CT"


def test_a_scan_of_the_skin_is_withheld_unless_asked_for(tmp_path: Path) -> None:
    run = recorded_run(
        tmp_path / "run",
        (StepKey("ct_import"), IMPORTED),
        (StepKey("skin_in_ct"), skin_in_ct()),
        (StepKey("surface_scan"), scanned_surface()),
        (StepKey("surface_registration"), registered_by_surface()),
        linked=True,
    )
    plain, full = export_run(run, tmp_path / "plain"), export_run(run, tmp_path / "full", with_scan=True)
    scan_files = {"scan.ply", "scan.vtp"}
    assert {path.name for path in full.files} - {path.name for path in plain.files} == scan_files
    assert json.loads((tmp_path / "plain" / "export.json").read_text())["withheld"] == dict(plain.withheld)
    assert "--with-scan" in plain.withheld["scan of the skin"]
    assert not full.withheld
    head, _, body = (tmp_path / "full" / "scan.ply").read_bytes().partition(b"end_header\n")
    points_mm = np.frombuffer(body, "<f8", count=3).tolist()
    assert "in the frame ct" in head.decode()
    np.testing.assert_allclose(points_mm, IN_CT_MM[0], atol=1e-9)
    assert "registers on the skin" in plain.absent["spheres"]
    assert not {path.name for path in plain.files} & {"spheres.dcm", "spheres.csv", "spheres.mrk.json"}
    assert (
        "UsedFiducialsSequence"
        not in dcmread(tmp_path / "plain" / "registration-all.dcm").RegistrationSequence[1]
    )
