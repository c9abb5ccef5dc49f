"""The export of a run: spheres once, one registration per trajectory, the last where there were several."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from pydicom import dcmread
from scipy.spatial.transform import Rotation

from procedures.exchange.errors import NothingToExport, NotWritable, UnknownForm
from procedures.exchange.run_export import export_run
from procedures.exchange.sphere_files import check_names
from procedures.steps.payloads import pose_payload
from ronna_hw.frames import Frame, Transform
from ronna_hw.records import BadRecord, Record, write_record

IMPORTED = Record(
    "01-ct_import", "ct_import", (), {"series_instance_uid": "1.2.3", "frame_of_reference_uid": "1.2.4"}
)
SPHERES = Record(
    "02-fiducial_localization",
    "fiducial_localization",
    ("01-ct_import",),
    {"markers": [{"centre_mm": [1.0, 2.0, 3.0], "covariance_mm2": (np.eye(3) * 3e-4).tolist()}]},
)


def fit(identifier: str, x_mm: float) -> Record:
    turn = Rotation.from_rotvec([0.0, 0.0, 0.5]).as_quat(scalar_first=True)
    pose = Transform.of(Frame.ROBOT, Frame.CT, translation_mm=[x_mm, 0.0, 0.0], quaternion_wxyz=turn)
    told = {
        "pairs": 5,
        "fre_mm": 0.1,
        "predicted_tre_mm": 0.2,
        "predicted_tre_limit_mm": 0.4,
        "confidence": 0.95,
    }
    return Record(identifier, "registration", (), {"robot_from_ct": pose_payload(pose), **told})


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    run = tmp_path / "run"
    (run / "records").mkdir(parents=True)
    fits = (fit("03-registration-T1", 1.0), fit("05-registration-T2", 2.0), fit("07-registration-T1", 3.0))
    for record in (IMPORTED, SPHERES, *fits):
        write_record(record, run / "records")
    return run


def test_a_run_gives_its_spheres_and_the_last_registration_of_each_trajectory(finished: Path) -> None:
    out = finished / "export"
    names = {path.name for path in export_run(finished, out)}
    assert names == {
        *("spheres.csv", "spheres.json", "spheres.mrk.json", "spheres.dcm"),
        *("registrations.csv", "registrations.json"),
        *("registration-T1.dcm", "registration-T2.dcm"),
    }
    assert (out / "spheres.csv").read_text().splitlines()[1].startswith("M1,1.0,2.0,3.0,0.03")
    told = json.loads((out / "registrations.json").read_text())["registrations"]
    assert [(one["trajectory"], one["robot_from_ct"]["translation_mm"][0]) for one in told] == [
        ("T1", 3.0),
        ("T2", 2.0),
    ]


def test_the_tables_hold_the_same_as_the_objects(finished: Path) -> None:
    out = finished / "export"
    export_run(finished, out)
    spheres = json.loads((out / "spheres.json").read_text())
    assert (spheres["series_instance_uid"], spheres["coordinate_system"]) == ("1.2.3", "LPS")
    assert [(one["name"], one["centre_mm"]) for one in spheres["spheres"]] == [("M1", [1.0, 2.0, 3.0])]
    assert np.array(spheres["spheres"][0]["covariance_mm2"]).shape == (3, 3)
    rows = list(csv.DictReader((out / "registrations.csv").read_text().splitlines()))
    assert [row["trajectory"] for row in rows] == ["T1", "T2"]
    for row in rows:
        read = dcmread(out / f"registration-{row['trajectory']}.dcm").RegistrationSequence[1]
        step = read.MatrixRegistrationSequence[0].MatrixSequence[0]
        matrix = np.array(step.FrameOfReferenceTransformationMatrix, dtype=float).reshape(4, 4)
        told = [float(row[f"m{i}{j}"]) for i in range(1, 4) for j in range(1, 5)]
        np.testing.assert_allclose(told, matrix[:3].ravel(), atol=1e-12)
        assert float(row["predicted_tre_mm"]) == 0.2


def test_the_registrations_name_the_spheres_that_are_beside_them(finished: Path) -> None:
    out = finished / "export"
    export_run(finished, out)
    spheres = dcmread(out / "spheres.dcm")
    first, second = (dcmread(out / f"registration-{name}.dcm") for name in ("T1", "T2"))
    used = first.RegistrationSequence[1].UsedFiducialsSequence[0]
    assert used.ReferencedSOPInstanceUID == spheres.SOPInstanceUID
    assert used.FiducialUID == spheres.FiducialSetSequence[0].FiducialSequence[0].FiducialUID
    assert first.FrameOfReferenceUID == second.FrameOfReferenceUID
    assert first.SOPInstanceUID != second.SOPInstanceUID


def test_a_run_without_a_registration_is_refused(tmp_path: Path) -> None:
    (tmp_path / "records").mkdir()
    for record in (IMPORTED, SPHERES):
        write_record(record, tmp_path / "records")
    with pytest.raises(NothingToExport, match="EXC-003"):
        export_run(tmp_path, tmp_path / "export")


def test_a_changed_record_is_not_exported(finished: Path) -> None:
    path = finished / "records" / "05-registration-T2.json"
    path.write_text(path.read_text().replace("0.95", "0.99"))
    with pytest.raises(BadRecord, match="REC-001"):
        export_run(finished, finished / "export")


def test_a_place_that_is_a_file_is_refused(finished: Path) -> None:
    (finished / "export").touch()
    with pytest.raises(NotWritable, match="EXC-002"):
        export_run(finished, finished / "export")


def test_an_unknown_form_is_refused_before_the_work() -> None:
    with pytest.raises(UnknownForm, match=r"EXC-001: cannot tell the form of spheres.xls"):
        check_names([Path("a.csv"), Path("spheres.xls")])
