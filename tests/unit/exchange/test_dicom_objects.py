"""Registration and fiducials as DICOM, read back by third-party programs.

GDCM, which the tests need anyway, reads every object. `dciodvfy` (Debian's dicom3tools) judges it against
the standard, `dcmdump` (dcmtk) reads it too; without these two programs their tests are left out and say so.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import gdcm
import numpy as np
import pytest
from coded_errors import raises
from localized_spheres import localized_marker
from pydicom.dataset import Dataset
from scipy.spatial.transform import RigidTransform, Rotation

from procedures.exchange.dicom_objects import (
    Origin,
    decimals,
    fiducial_uid,
    spatial_registration,
    sphere_fiducials,
    write,
)
from procedures.exchange.errors import NOT_WRITABLE
from procedures.exchange.export_tables import CtIdentity
from procedures.exchange.sphere_files import slicer_markups, table
from ronna_hw.frames import Frame, Transform

ORIGIN = Origin("1.2.826.0.1.1", "1.2.826.0.1.2", datetime(2026, 11, 20, 9, 30, tzinfo=UTC), "a hash")
SPHERES = (
    localized_marker((12.345678, -1e-3, 100.0), np.diag([0.0123 * 0.0123, 0.0, 0.0])),
    localized_marker((-80.0, 33.3, 7.25), np.diag([0.02 * 0.02, 0.0, 0.0])),
)
NAMES = ("M1", "M2")
NUMBERED = dict(enumerate(SPHERES, start=1))
POSE = Transform(
    Frame.ROBOT,
    Frame.CT,
    RigidTransform.from_components([700.1, -20.2, 300.3], Rotation.from_rotvec([0.1, 2.0, -0.7])),
)


REGISTRATIONS, MATRIX_REGISTRATIONS, MATRICES = (0x0070, 0x0308), (0x0070, 0x0309), (0x0070, 0x030A)
MATRIX, FRAME_OF_REFERENCE = (0x3006, 0x00C6), (0x0020, 0x0052)
FIDUCIAL_SETS, FIDUCIALS = (0x0070, 0x031C), (0x0070, 0x031E)
NAME, CENTRE, UNIQUE_NAME = (0x0070, 0x0310), (0x3006, 0x0050), (0x0070, 0x031A)


class GdcmObject:
    """A DICOM object as GDCM reads it: items of sequences, and values as text."""

    def __init__(self, path: Path) -> None:
        self.reader = gdcm.Reader()  # owns what it read
        self.reader.SetFileName(str(path))
        assert self.reader.Read()
        self.whole = self.reader.GetFile().GetDataSet()
        self._text = gdcm.StringFilter()
        self._text.SetFile(self.reader.GetFile())

    def items(self, within: Any, tag: tuple[int, int]) -> list[Any]:
        sequence = within.GetDataElement(gdcm.Tag(*tag)).GetValueAsSQ()
        return [sequence.GetItem(k + 1).GetNestedDataSet() for k in range(sequence.GetNumberOfItems())]

    def text(self, within: Any, tag: tuple[int, int]) -> str:
        return str(self._text.ToString(within.GetDataElement(gdcm.Tag(*tag)))).strip("\0 ")

    def numbers(self, within: Any, tag: tuple[int, int]) -> list[float]:
        return [float(one) for one in self.text(within, tag).split("\\")]


def needs(program: str) -> pytest.MarkDecorator:
    missing = shutil.which(program) is None
    return pytest.mark.skipif(
        missing, reason=f"proof by {program} not made: install Debian's dicom3tools, dcmtk"
    )


def registration() -> Dataset:
    used = [fiducial_uid(ORIGIN, name) for name in NAMES]
    return spatial_registration(POSE, ORIGIN, description="trajectory T1", fiducial_uids=used)


OBJECTS = {"registration": registration, "fiducials": lambda: sphere_fiducials(NUMBERED, ORIGIN)}


def test_the_objects_of_a_ct_share_its_study_or_one_that_is_derived_from_it() -> None:
    known = replace(ORIGIN, study_instance_uid="1.2.826.0.1.3")
    assert sphere_fiducials(NUMBERED, known).StudyInstanceUID == "1.2.826.0.1.3"
    assert spatial_registration(POSE, known).StudyInstanceUID == "1.2.826.0.1.3"
    others = replace(ORIGIN, key="another result")
    assert len({sphere_fiducials(NUMBERED, one).StudyInstanceUID for one in (ORIGIN, others)}) == 1
    assert len({sphere_fiducials(NUMBERED, one).SeriesInstanceUID for one in (ORIGIN, others)}) == 2


def test_a_registration_says_in_which_direction_its_matrix_maps() -> None:
    own, ct = registration().RegistrationSequence
    (mapping,) = ct.MatrixRegistrationSequence
    assert mapping.FrameOfReferenceTransformationComment.startswith("robot <- CT: ")
    assert own.FrameOfReferenceUID == registration().FrameOfReferenceUID  # the identity needs no comment


def dump(path: Path) -> str:
    return subprocess.run(["dcmdump", "+L", str(path)], capture_output=True, text=True, check=True).stdout


@needs("dciodvfy")
@pytest.mark.parametrize("kind", OBJECTS)
def test_the_dicom_validator_finds_no_error(kind: str, tmp_path: Path) -> None:
    path = write(OBJECTS[kind](), tmp_path / "object.dcm")
    said = subprocess.run(["dciodvfy", "-new", str(path)], capture_output=True, text=True).stderr
    assert f"Spatial{kind.capitalize()}" in said
    assert "Error" not in said, said


def test_gdcm_reads_the_same_matrix_between_the_same_frames(tmp_path: Path) -> None:
    read = GdcmObject(write(registration(), tmp_path / "reg.dcm"))
    robot, ct = read.items(read.whole, REGISTRATIONS)
    assert read.text(robot, FRAME_OF_REFERENCE) == read.text(read.whole, FRAME_OF_REFERENCE)
    assert read.text(ct, FRAME_OF_REFERENCE) == ORIGIN.frame_of_reference_uid
    found = []
    for item in (robot, ct):
        (step,) = read.items(item, MATRIX_REGISTRATIONS)
        (matrix,) = read.items(step, MATRICES)
        found.append(np.array(read.numbers(matrix, MATRIX)).reshape(4, 4))
    assert np.array_equal(found[0], np.eye(4))
    points = np.array([sphere.centre_mm for sphere in SPHERES])
    mapped = points @ found[1][:3, :3].T + found[1][:3, 3]
    assert np.abs(mapped - POSE.apply(points)).max() < 1e-9


def test_gdcm_reads_the_same_spheres(tmp_path: Path) -> None:
    read = GdcmObject(write(sphere_fiducials(NUMBERED, ORIGIN), tmp_path / "fid.dcm"))
    (group,) = read.items(read.whole, FIDUCIAL_SETS)
    assert read.text(group, FRAME_OF_REFERENCE) == ORIGIN.frame_of_reference_uid
    spheres = read.items(group, FIDUCIALS)
    assert tuple(read.text(one, NAME) for one in spheres) == NAMES
    assert [tuple(read.numbers(one, CENTRE)) for one in spheres] == [one.centre_mm for one in SPHERES]
    assert [read.text(one, UNIQUE_NAME) for one in spheres] == [fiducial_uid(ORIGIN, name) for name in NAMES]


@needs("dcmdump")
def test_dcmtk_reads_the_same_matrix(tmp_path: Path) -> None:
    said = dump(write(registration(), tmp_path / "reg.dcm"))
    matrices = re.findall(r"\(3006,00c6\) DS \[([^\]]*)\]", said)
    read = [np.array([float(x) for x in text.split("\\")]).reshape(4, 4) for text in matrices]
    assert np.array_equal(read[0], np.eye(4))
    points = np.array([sphere.centre_mm for sphere in SPHERES])
    mapped = points @ read[1][:3, :3].T + read[1][:3, 3]
    assert np.abs(mapped - POSE.apply(points)).max() < 1e-9
    assert ORIGIN.frame_of_reference_uid in said


@needs("dcmdump")
def test_dcmtk_reads_the_same_spheres(tmp_path: Path) -> None:
    said = dump(write(sphere_fiducials(NUMBERED, ORIGIN), tmp_path / "fid.dcm"))
    centres = re.findall(r"\(3006,0050\) DS \[([^\]]*)\]", said)
    assert [tuple(float(x) for x in text.split("\\")) for text in centres] == [s.centre_mm for s in SPHERES]
    assert re.findall(r"\(0070,0312\) FD ([\d.]+)", said) == ["0.0123", "0.02"]
    assert all(fiducial_uid(ORIGIN, name) in said for name in NAMES)


@pytest.mark.hazard(35)
def test_no_object_contains_patient_data() -> None:
    for make in OBJECTS.values():
        made = make()
        assert not any(str(made.get(name)) for name in ("PatientName", "PatientID", "PatientBirthDate"))


def test_equal_results_give_equal_objects_and_different_ones_different_uids() -> None:
    again = Origin("1.2.826.0.1.1", "1.2.826.0.1.2", ORIGIN.made, "another hash")
    assert registration() == registration()
    assert (
        sphere_fiducials(NUMBERED, again).SOPInstanceUID != sphere_fiducials(NUMBERED, ORIGIN).SOPInstanceUID
    )


@pytest.mark.parametrize("value", [0.1234567890123456789, -1e-17, 123456.78901234567, -1.0, 3e-300, 0.0])
def test_a_number_is_written_as_precisely_as_sixteen_characters_allow(value: float) -> None:
    (text,) = decimals([value])
    assert len(text) <= 16
    assert float(text) == pytest.approx(value, rel=1e-9, abs=1e-12)


def test_an_unwritable_path_is_reported(tmp_path: Path) -> None:
    with raises(NOT_WRITABLE, match="EXC-002"):
        write(registration(), tmp_path / "no" / "such.dcm")


def test_plain_files_contain_names_centres_and_uncertainties() -> None:
    ct = CtIdentity("1.2.826.0.1.1", "1.2.826.0.1.2", "1.2.826.0.1.3")
    place = "12.345678,-0.001,100.0"
    row = f"M1,{place},0.0123,{place},LPS,ct,mm,1.2.826.0.1.1,1.2.826.0.1.2,1.2.826.0.1.3"
    assert table(NUMBERED, ct).splitlines()[1] == row
    assert '"coordinateSystem": "LPS"' in slicer_markups(NUMBERED, ct)
    assert "-80.0" in slicer_markups(NUMBERED, ct)
