"""Hazard 35: names planted in the series and the plan appear in nothing that an export writes."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from finished_runs import recorded_run
from localized_spheres import localized_marker
from painted_ct import write_series
from prepared_results import checked_plan, registered_robot
from pydicom import dcmread
from recording_cell import RecordingCell
from spoiled_slices import every, setting
from user_commands import in_this_process

from procedures.cli.procedure import app
from procedures.engine.case import StepKey
from procedures.engine.order import order_of
from procedures.exchange import allowed_fields
from procedures.exchange.allowed_fields import require_allowed
from procedures.exchange.errors import FIELD_NOT_ALLOWED
from procedures.exchange.run_export import export_run
from procedures.steps.clinical import ct_import
from procedures.steps.clinical.ct_import import ImportedCt
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials

SOWN = ("Sown^Patient", "SOWN-ID", "19610203", "Sown Hospital", "Sown^Physician", "Sown Station", "SownLeft")
WORDS = (
    *("PatientName", "PatientID", "PatientBirthDate", "InstitutionName", "ReferringPhysicianName"),
    "StationName",
)
NAMED_AFTER_THE_PATIENT = SOWN[-1]


def imported_from_a_sown_series(folder: Path) -> ImportedCt:
    """What the import leaves of a series whose headers are full of patient data."""
    cell = RecordingCell(folder)
    named = every(setting(**dict(zip(WORDS, SOWN, strict=False))))
    write_series(cell.series, np.full((12, 32, 32), -1000, dtype=np.int16), edit=named)
    cell.engine(order_of([ct_import.STEP], ())).run_to()
    return cell.case.get(ImportedCt).result


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run with a sown series and a trajectory that is named after its patient."""
    marker = localized_marker((1.0, 2.0, 3.0), np.eye(3) * 1e-4, agreement_mm=0.01)
    imported = imported_from_a_sown_series(tmp_path / "import")
    spheres = LocalizedFiducials(
        series_instance_uid=imported.series_instance_uid, diameter_mm=11.5, markers=(marker,), doubtful=()
    )
    done = registered_robot()
    (first, *_) = done.predictions
    fit = done.model_copy(
        update={"predictions": (first.model_copy(update={"target": NAMED_AFTER_THE_PATIENT}),)}
    )
    checked = checked_plan()
    (planned, *_) = checked.plan.trajectories
    named = planned.model_copy(update={"id": NAMED_AFTER_THE_PATIENT})
    plan = checked.plan.model_copy(update={"trajectories": (named,)})
    return recorded_run(
        tmp_path / "run",
        (StepKey("ct_import"), imported),
        (StepKey("fiducial_localization"), spheres),
        (StepKey("plan_check"), checked.model_copy(update={"plan": plan})),
        (StepKey("registration", NAMED_AFTER_THE_PATIENT), fit),
    )


@pytest.mark.hazard(35)
def test_no_planted_name_appears_in_any_exported_file_or_its_name(run: Path, tmp_path: Path) -> None:
    written = export_run(run, tmp_path / "export").files
    assert {path for path in (tmp_path / "export").rglob("*") if path.is_file()} == set(written)
    for path in written:
        content = path.read_bytes()
        for name in SOWN:
            assert name.encode() not in content, path.name
            assert name not in path.name
    assert (tmp_path / "export" / "registration-trajectory1.dcm") in written


def keys_of(content: object) -> Iterator[str]:
    if isinstance(content, dict):
        for key, value in content.items():
            yield key
            if key != "robot_from_ct":
                yield from keys_of(value)
    elif isinstance(content, list):
        for value in content:
            yield from keys_of(value)


@pytest.mark.hazard(35)
def test_every_exported_field_is_on_the_allow_list(run: Path, tmp_path: Path) -> None:
    out = tmp_path / "export"
    export_run(run, out)
    listed = {
        *allowed_fields.SPHERE_FIELDS,
        *allowed_fields.REGISTRATION_FIELDS,
        *allowed_fields.DOCUMENT_FIELDS,
    }
    for name in ("spheres.json", "registrations.json"):
        assert set(keys_of(json.loads((out / name).read_text()))) <= listed
    for name in ("lines.csv", "errors.csv", "spheres.csv", "registrations.csv"):
        with (out / name).open() as file:
            assert next(csv.reader(file)) == [one.name for one in allowed_fields.TABLES[name]]
    attributes = {*allowed_fields.EMPTY_ATTRIBUTES, *allowed_fields.FILLED_ATTRIBUTES}
    for path in out.glob("*.dcm"):
        elements = list(dcmread(path).iterall())
        assert {one.keyword for one in elements} <= attributes, path.name
        assert all(one.is_empty for one in elements if one.keyword in allowed_fields.EMPTY_ATTRIBUTES)


@pytest.mark.hazard(35)
@pytest.mark.parametrize("attribute", ["PatientName", "InstitutionName"])
def test_an_object_with_any_other_field_is_refused(run: Path, tmp_path: Path, attribute: str) -> None:
    export_run(run, tmp_path / "export")
    made = dcmread(tmp_path / "export" / "spheres.dcm")
    require_allowed(made)
    if attribute == "PatientName":
        made.PatientName = "Sown^Patient"
    else:
        setattr(made, attribute, "Sown Hospital")
    with raises(FIELD_NOT_ALLOWED, match=f"EXC-004.*{attribute}"):
        require_allowed(made)


def series_of(run: Path, folder: Path, **attributes: object) -> Path:
    """The CT of a run as it lies in the clinic, with its patient."""
    imported = json.loads(next((run / "records").glob("*ct_import*")).read_text())["payload"]
    uids = {"SeriesInstanceUID": imported["series_instance_uid"]}
    named = every(setting(**{**dict(zip(WORDS, SOWN, strict=False)), **uids, **attributes}))
    return write_series(folder, np.full((12, 32, 32), -1000, dtype=np.int16), edit=named)


@pytest.mark.hazard(35)
def test_an_identity_on_request_is_in_the_dicom_objects_alone_and_in_the_attributes_that_file_them(
    run: Path, tmp_path: Path
) -> None:
    ct, named, plain = series_of(run, tmp_path / "ct"), tmp_path / "named", tmp_path / "plain"
    given = in_this_process(app, "export", run, "--identity-from", ct, "--out", named)
    assert given.returncode == 0, given.stderr
    assert "identifier SOWN-ID" in given.stderr
    export_run(run, plain)
    for path in plain.iterdir():
        content = (named / path.name).read_bytes()
        if path.suffix != ".dcm":
            assert not [word for word in SOWN if word.encode() in content], path.name
            continue
        filled = {one.keyword for one in dcmread(named / path.name) if one != dcmread(path).get(one.tag)}
        assert filled - {"StudyInstanceUID", "ReferencedFrameOfReferenceSequence"} == {
            *("PatientName", "PatientID", "PatientBirthDate", "ReferringPhysicianName")
        }


@pytest.mark.hazard(35)
@pytest.mark.parametrize("out", [None, "export", "elsewhere/../export"])
def test_no_identity_is_written_into_a_run_folder(run: Path, tmp_path: Path, out: str | None) -> None:
    ct = series_of(run, tmp_path / "ct")
    into = () if out is None else ("--out", run / out)
    refused = in_this_process(app, "export", run, "--identity-from", ct, *into)
    assert refused.returncode == 2
    assert "CLI-001: --identity-from needs a folder outside the run" in refused.stderr
    assert not (run / "export").exists()
