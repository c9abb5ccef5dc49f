"""The export of a run: its spheres once, and the last registration of each trajectory."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest
from prepared_results import SERIES, imported_ct, localized_fiducials, registered_robot
from pydicom import dcmread
from scipy.spatial.transform import Rotation

from procedures.engine.case import Case, StepKey
from procedures.exchange.errors import NothingToExport, NotWritable, UnknownForm
from procedures.exchange.run_export import export_run
from procedures.exchange.sphere_files import check_names
from procedures.journal.journal import Entry, Journal
from procedures.journal.results import StepResult
from procedures.steps.clinical.results import RegisteredRobot
from ronna_hw.evidence.journal_reading import RunChanged
from ronna_hw.evidence.manifest import RAW_FOLDER, hash_files_at_closing, seal
from ronna_hw.frames import Frame, Transform
from ronna_hw.records import OtherVersion

IMPORTED = imported_ct()
SPHERES = localized_fiducials(np.array([[1.0, 2.0, 3.0]]))


def fit(trajectory: str, x_mm: float) -> RegisteredRobot:
    turn = Rotation.from_rotvec([0.0, 0.0, 0.5]).as_quat(scalar_first=True)
    pose = Transform.of(Frame.ROBOT, Frame.CT, translation_mm=[x_mm, 0.0, 0.0], quaternion_wxyz=turn)
    done = registered_robot(pose)
    return done.model_copy(update={"predictions": (done.prediction(trajectory),)})


def record(run: Path, *results: tuple[StepKey, StepResult]) -> Path:
    """A run folder with these results, in this order, each in place of a former one of its step."""
    run.mkdir(exist_ok=True)
    case, journal = Case(run), Journal(run)
    for key, result in results:
        stored = case.store(key, result, ())
        gone = [one.identifier for one in case.records_superseded_by(key)]
        names = {"record": stored.record.identifier, "sha256": stored.record.sha256}
        journal.write(Entry.RESULT, 0.0, step=str(key), supersedes=gone, **names)
        case.accept(key, stored)
    files = hash_files_at_closing(run)
    journal.write(Entry.CLOSED, 0.0, outcome="done", files=files)
    journal.close()
    seal(run, files)
    return run


IN_CT = ((StepKey("ct_import"), IMPORTED), (StepKey("fiducial_localization"), SPHERES))


@pytest.fixture
def finished(tmp_path: Path) -> Path:
    fits = (("T1", 1.0), ("T2", 2.0), ("T1", 3.0))
    return record(
        tmp_path / "run", *IN_CT, *((StepKey("registration", name), fit(name, x)) for name, x in fits)
    )


def test_an_export_has_the_spheres_and_the_last_registration_of_each_trajectory(finished: Path) -> None:
    out = finished / "export"
    names = {path.name for path in export_run(finished, out)}
    assert names == {
        *("spheres.csv", "spheres.json", "spheres.mrk.json", "spheres.dcm"),
        *("registrations.csv", "registrations.json"),
        *("registration-T1.dcm", "registration-T2.dcm"),
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


def test_a_run_without_a_registration_is_refused(tmp_path: Path) -> None:
    run = record(tmp_path / "run", *IN_CT)
    with pytest.raises(NothingToExport, match="EXC-003"):
        export_run(run, tmp_path / "export")


def test_a_changed_record_is_not_exported(finished: Path) -> None:
    path = finished / "records" / "04-registration-T2.json"
    path.write_text(path.read_text().replace("0.95", "0.99"))
    with pytest.raises(RunChanged, match=r"PRO-033: .*04-registration-T2"):
        export_run(finished, finished / "export")


def test_a_missing_record_is_named_and_nothing_is_exported(finished: Path) -> None:
    (finished / "records" / "04-registration-T2.json").unlink()
    with pytest.raises(RunChanged, match=r"PRO-033: .*04-registration-T2\.json: missing"):
        export_run(finished, finished / "export")
    assert not (finished / "export").exists()


def test_a_record_of_another_version_is_not_exported(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(RegisteredRobot, "version", 2)
    with pytest.raises(OtherVersion, match=r"REC-003.*expected registration version 2, got version 1"):
        export_run(finished, finished / "export")


def test_an_export_path_that_is_a_file_is_refused(finished: Path) -> None:
    (finished.parent / "export").touch()
    with pytest.raises(NotWritable, match="EXC-002"):
        export_run(finished, finished.parent / "export")


def test_a_registration_of_another_run_does_not_stay_among_the_exported_ones(finished: Path) -> None:
    out = finished.parent / "exported"
    export_run(finished, out)
    export_run(finished, out)
    (out / "registration-T9.dcm").touch()
    with pytest.raises(NotWritable, match=r"EXC-002.*registration-T9\.dcm"):
        export_run(finished, out)


def test_an_export_replaces_links_instead_of_writing_through_them(finished: Path) -> None:
    out, precious = finished.parent / "exported", finished.parent / "precious"
    names = [path.name for path in export_run(finished, out)]
    precious.write_text("precious")
    for name in names:
        (out / name).unlink()
        (out / name).symlink_to(precious)
        (out / f".{name}.partial").symlink_to(precious)
    export_run(finished, out)
    assert precious.read_text() == "precious"
    assert not any(path.is_symlink() for path in out.iterdir())


def test_an_unknown_file_format_is_refused() -> None:
    with pytest.raises(UnknownForm, match=r"EXC-001: cannot tell the format of spheres.xls"):
        check_names([Path("a.csv"), Path("spheres.xls")])


def test_pictures_kept_in_a_run_are_not_exported(finished: Path, tmp_path: Path) -> None:
    pictures = finished / RAW_FOLDER / "pictures"
    pictures.mkdir(parents=True)
    (pictures / "00001-left.png").write_bytes(b"a picture")
    (finished / "readings").mkdir(exist_ok=True)
    closed = json.loads((finished / "journal.jsonl").read_text().splitlines()[-1])["files"]
    seal(finished, closed)
    written = export_run(finished, tmp_path / "export")
    assert {path.suffix for path in written} == {".csv", ".json", ".dcm"}
    assert sorted(written) == sorted(path for path in (tmp_path / "export").rglob("*") if path.is_file())
    assert not any(b"a picture" in path.read_bytes() for path in written)
