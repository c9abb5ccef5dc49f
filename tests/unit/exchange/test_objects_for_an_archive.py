"""DICOM objects of a run beside its CT: filed with its patient in its study, and read by foreign programs.

`dciodvfy` (Debian's dicom3tools) judges them against the standard; dcmtk's `dcmdump`, `dsrdump` and
`dcmj2pnm` read what they hold. Without these programs their tests are left out and say so.
"""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from clinical_case import FIRST
from coded_errors import raises
from painted_ct import SERIES_UID, write_series
from prepared_results import SERIES
from pydicom import DataElement, Dataset, config, dcmread
from spoiled_slices import every, setting
from whole_run import PLAN, SPHERES, whole_run

from procedures.exchange import postoperative_objects
from procedures.exchange.case_results import read_results
from procedures.exchange.ct_study import COPIED, read_ct_study
from procedures.exchange.errors import CT_OF_NO_PATIENT, OTHER_CT
from procedures.exchange.report_page import draw_page
from procedures.exchange.run_export import export_run
from procedures.reporting.run_reading import RunReading
from ronna_hw.evidence.inspection import inspect_run

DRAWN = datetime(2026, 11, 30, tzinfo=UTC)
PATIENT = {
    "PatientName": "Müller^Jörg",
    "PatientID": "00123",
    "PatientBirthDate": "19610203",
    "PatientSex": "O",
    "StudyInstanceUID": "1.2.4",
    "StudyDate": "20180601",
    "StudyTime": "120000.5",
    "StudyID": "7",
    "AccessionNumber": "A-17",
    "ReferringPhysicianName": "Kovač^Ana",
}
KINDS = {
    "spheres.dcm": "SpatialFiducials",
    "registration-all.dcm": "SpatialRegistration",
    "structures.dcm": "RTStructureSet",
    "report-page.dcm": "SCImage",
    "postoperative-report.dcm": "Comprehensive3DSR",
}


def needs(program: str) -> pytest.MarkDecorator:
    missing = shutil.which(program) is None
    return pytest.mark.skipif(
        missing, reason=f"proof by {program} not made: install Debian's dicom3tools, dcmtk"
    )


def scan(folder: Path, *changes: Callable[[Dataset], None], **attributes: object) -> Path:
    """The CT of the run, with its patient."""
    values = {"SeriesInstanceUID": SERIES, "SpecificCharacterSet": "ISO_IR 101", **PATIENT, **attributes}

    def edit(data: Dataset) -> None:
        for change in (setting(**values), *changes):
            change(data)

    return write_series(folder, np.full((12, 16, 16), -1000, dtype=np.int16), edit=every(edit))


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The export of a run that has everything, into the study of its CT."""
    folder = tmp_path_factory.mktemp("archive")
    export_run(whole_run(folder / "run"), folder / "out", identity_from=scan(folder / "ct"))
    return folder / "out"


def read(out: Path) -> dict[str, Dataset]:
    return {path.name: dcmread(path) for path in out.glob("*.dcm")}


def test_all_objects_are_of_the_patient_and_in_the_study_of_the_ct_each_in_a_series_of_its_own(
    out: Path,
) -> None:
    objects = read(out)
    assert set(objects) == set(KINDS)
    for name, one in objects.items():
        assert {keyword: str(one[keyword].value) for keyword in COPIED} == PATIENT, name
    series = {one.SeriesInstanceUID for one in objects.values()}
    assert len(series) == len(KINDS)
    assert SERIES not in series
    assert json.loads((out / "export.json").read_text())["identified"] is True


def test_without_an_identity_the_objects_share_the_study_and_name_nobody(tmp_path: Path) -> None:
    export_run(whole_run(tmp_path / "run"), tmp_path / "out")
    for name, one in read(tmp_path / "out").items():
        assert one.StudyInstanceUID == PATIENT["StudyInstanceUID"], name
        assert not [keyword for keyword in set(COPIED) - {"StudyInstanceUID"} if one.get(keyword)], name


def test_a_value_that_the_standard_does_not_allow_is_copied_as_the_archive_has_it(tmp_path: Path) -> None:
    def date_as_old_scanners_do(data: Dataset) -> None:
        birth = data["PatientBirthDate"]
        data[birth.tag] = DataElement(birth.tag, birth.VR, "1961.02.03", validation_mode=config.IGNORE)

    ct = scan(tmp_path / "ct", date_as_old_scanners_do)
    export_run(whole_run(tmp_path / "run"), tmp_path / "out", identity_from=ct)
    for path in (tmp_path / "out").glob("*.dcm"):
        assert b"1961.02.03" in path.read_bytes(), path.name


@needs("dciodvfy")
@pytest.mark.parametrize("name", KINDS)
def test_the_dicom_validator_finds_no_error(out: Path, name: str) -> None:
    said = subprocess.run(["dciodvfy", "-new", str(out / name)], capture_output=True, text=True).stderr
    assert KINDS[name] in said
    assert "Error" not in said, said


@needs("dcmdump")
def test_dcmtk_reads_spheres_and_trajectories_of_the_structure_set_in_the_frame_of_the_ct(out: Path) -> None:
    said = subprocess.run(
        ["dcmdump", "+L", str(out / "structures.dcm")], capture_output=True, text=True, check=True
    ).stdout
    names = re.findall(r"\(3006,0026\) LO \[([^\]]*)\]", said)
    kinds = re.findall(r"\(3006,0042\) CS \[([^\]]*)\]", said)
    points = [
        tuple(map(float, text.split("\\"))) for text in re.findall(r"\(3006,0050\) DS \[([^\]]*)\]", said)
    ]
    (sphere,) = SPHERES.markers
    assert (names[0], kinds[0], points[0]) == ("M1", "POINT", tuple(sphere.centre_mm))
    assert set(kinds[1:]) == {"OPEN_NONPLANAR"}
    lines = dict(zip(names[1:], points[1:], strict=True))
    assert set(lines) == {
        *(f"{one.id} planned" for one in PLAN.plan.trajectories),
        *(f"{FIRST} {kind}" for kind in ("reached", "found")),
    }
    for one in PLAN.plan.trajectories:
        assert lines[f"{one.id} planned"] == pytest.approx((*one.entry_mm, *one.target_mm))
    assert set(re.findall(r"\((?:0020,0052|3006,0024)\) UI \[([^\]]*)\]", said)) == {"1.2.3"}
    assert f"{SERIES_UID}.12" in said  # the slices that it is drawn on


@needs("dsrdump")
def test_dcmtk_reads_the_errors_after_the_operation_with_their_units(out: Path) -> None:
    said = subprocess.run(
        ["dsrdump", "+Pl", str(out / "postoperative-report.dcm")], capture_output=True, text=True, check=True
    ).stdout
    assert f'"Tracking Identifier")="{FIRST}"' in said
    found = re.findall(r'NUM:\(,,"([^"]*)"\)="([^"]*)" \((\w+),UCUM', said)
    assert [(name.split(",")[0], value, unit) for name, value, unit in found] == [
        ("Error at the entry", "0.0", "mm"),
        ("Error at the target", "1.0", "mm"),
        ("Error at the target", "0.8", "mm"),
        ("Depth error", "0.6", "mm"),
        ("Angle between planned and found axis", "1.0", "deg"),
    ]
    assert said.count("SCOORD3D") == 6  # the angle is between two lines


def test_highdicom_reads_its_template_back_with_the_points_in_the_frame_of_the_ct(out: Path) -> None:
    from highdicom.sr import srread

    content = srread(out / "postoperative-report.dcm").content
    (group,) = content.get_image_measurement_groups()
    by_name = {one.name.value: one for one in group.get_measurements()}
    (line,) = by_name["TARGET"].referenced_coordinates
    (x, y, z) = PLAN.plan.trajectories[0].target_mm
    assert line.value == pytest.approx(np.array([(x, y, z), (x + 1.0, y, z)]), rel=1e-6)
    assert line.frame_of_reference_uid == "1.2.3"


@needs("dcmj2pnm")
def test_dcmtk_draws_the_page_of_the_report(out: Path, tmp_path: Path) -> None:
    page, drawn = out / "report-page.dcm", tmp_path / "page.ppm"
    subprocess.run(["dcmj2pnm", "+on", str(page), str(drawn)], check=True, capture_output=True)
    assert drawn.stat().st_size
    pixels = dcmread(page).pixel_array
    ink = (pixels.max(axis=2) < 128).mean()
    assert 0.002 < ink < 0.2
    assert dcmread(page).BurnedInAnnotation == "NO"


def test_the_page_turns_red_where_the_ct_after_the_operation_shows_more_than_the_plan_accepts(
    tmp_path: Path,
) -> None:
    run = whole_run(tmp_path / "run")
    results = read_results(RunReading.of(inspect_run(run)), lambda _run: None)
    assert results.check is not None
    (found,) = results.check.trajectories
    within, beyond = (
        draw_page(
            replace(results, check=results.check.model_copy(update={"trajectories": (changed,)})), DRAWN
        )
        for changed in (found, found.model_copy(update={"target_error_mm": 2.5}))
    )
    changed = (within != beyond).any(axis=2)
    assert changed.any()
    red, green = (beyond[changed][:, channel].astype(int) for channel in (0, 1))
    assert (red - green).max() > 100


def test_without_the_package_the_structured_report_is_absent_with_the_line_that_installs_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(postoperative_objects.importlib.util, "find_spec", lambda _name: None)
    absent = export_run(whole_run(tmp_path / "run"), tmp_path / "out").absent
    assert "EXC-009" in absent["structured report"]
    assert "pip install 'ronna-hw[dicom]'" in absent["structured report"]
    assert not (tmp_path / "out" / "postoperative-report.dcm").exists()


@pytest.mark.hazard(9)
def test_the_patient_of_another_ct_is_not_copied(tmp_path: Path) -> None:
    with raises(OTHER_CT, match=f"EXC-007.*expected series {SERIES}, got 1.2.9"):
        read_ct_study(scan(tmp_path / "ct", SeriesInstanceUID="1.2.9"), SERIES)
    with raises(OTHER_CT, match="EXC-007.*another study; expected 1.2.7"):
        read_ct_study(scan(tmp_path / "moved"), SERIES, "1.2.7")


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({"PatientID": ""}, "0 patient identifiers"),
        ({"StudyInstanceUID": ""}, "0 studies"),
    ],
)
def test_a_ct_without_patient_or_study_is_refused(
    tmp_path: Path, attributes: dict[str, str], words: str
) -> None:
    with raises(CT_OF_NO_PATIENT, match=f"EXC-008.*{words}"):
        read_ct_study(scan(tmp_path / "ct", **attributes), SERIES)


@pytest.mark.parametrize(
    ("attribute", "words"),
    [("PatientID", "2 patient identifiers"), ("PatientName", "2 patient names")],
)
def test_a_ct_of_two_patients_is_refused_without_naming_them(
    tmp_path: Path, attribute: str, words: str
) -> None:
    folder = scan(tmp_path / "ct")
    other = dcmread(folder / "0003.dcm")
    setattr(other, attribute, "SOMEBODY")
    other.save_as(folder / "0003.dcm")
    with raises(CT_OF_NO_PATIENT, match=f"EXC-008.*{words}") as refused:
        read_ct_study(folder, SERIES)
    assert "SOMEBODY" not in str(refused.value)
