"""A scan of the clamped head stands in for the spheres of the CT, and only one of the operation is taken."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from clinical_case import ClinicalCell, done_later
from coded_errors import raises
from prepared_results import checked_plan, clamped_head, imported_ct, localized_fiducials
from pydicom import dcmread
from scanned_head import PLACE_SIGMA_MM, scanned_spheres
from scipy.spatial.transform import RigidTransform

from procedures.engine.case import results_of, stand_ins
from procedures.engine.context import StepContext
from procedures.engine.methods import CaseMethods
from procedures.fusion.record import FusedPose
from procedures.imaging.markers import Candidate, Localization
from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.intraoperative.bone_pose import BonePose, PoseEstimate
from procedures.intraoperative.errors import NOT_LATER, OTHER_PATIENT, SCAN_MISSING, TooFewWhole
from procedures.intraoperative.placement import PlacedScan, SpherePair
from procedures.operator.errors import NotConfirmed
from procedures.operator.question import Question, Topic
from procedures.planning.target_error import scan_errors
from procedures.registration.error_sources import SCAN_PLACE
from procedures.steps.catalogue import CLINICAL_STEPS, clinical_steps
from procedures.steps.clinical import intraoperative_scan
from procedures.steps.clinical.fiducial_localization import IntraoperativeSpheres, LocalizedFiducials
from procedures.steps.clinical.intraoperative_scan import (
    STEP,
    _record,
    describe_scan,
    find_unused,
    localize_whole,
    number_spheres,
    require_scan_of_operation,
)
from procedures.workcell import MountedTool
from ronna_hw.records import Record
from ronna_hw.vectors import vector3
from sim.phantom.scanner.dicom_series import DicomSeries
from sim.phantom.scanner.grid import CtGrid
from sim.world.scene.model import CtProtocol, Scene
from sim.world.scene.named_scenes import draw_scene

TINY = CtProtocol(pixel_mm=1.0, slice_mm=1.0, columns=16, rows=16, slices=1)


def write_slice(folder: Path, scene: Scene, date: str, occasion: str = "the operation") -> Path:
    grid = CtGrid((0.0, 0.0, 0.0), 1.0, 1.0, 16, 16, 1)
    series = DicomSeries(scene.model_copy(update={"ct": TINY}), grid, folder, date=date, occasion=occasion)
    series.prepare()
    series.write(0, np.zeros((16, 16), "<u2"))
    return folder


def test_later_steps_read_the_scan_in_place_of_the_ct_and_earlier_ones_the_ct() -> None:
    steps = {step.name: step for step in clinical_steps(intraoperative=True)}
    assert list(steps).index("intraoperative_scan") == list(steps).index("head_clamp") + 1
    readers = {
        step.name for step in CLINICAL_STEPS if LocalizedFiducials in step.reads and step.name != "plan_check"
    }
    assert {name for name, step in steps.items() if IntraoperativeSpheres in step.reads} == readers
    assert LocalizedFiducials in steps["plan_check"].reads
    assert LocalizedFiducials in steps["intraoperative_scan"].reads
    assert clinical_steps() == CLINICAL_STEPS


def test_seating_no_longer_counts_and_the_place_of_the_scan_does() -> None:
    result = scanned_spheres()
    assert result.seating_mm(0.05) == 0.0
    (place,) = result.place_errors((0.0, 0.0, 0.0), np.eye(3), 4)
    assert place.source == SCAN_PLACE
    assert np.all(place.at_spheres_mm == 0.0)
    variance_mm2 = float(np.sum(np.asarray(place.at_target_mm) ** 2))
    assert variance_mm2 == pytest.approx(3.0 * PLACE_SIGMA_MM**2)


def test_strain_of_the_scan_acts_on_its_spheres_and_that_of_the_ct_on_the_target() -> None:
    quarter_turn = (0.5**0.5, 0.5**0.5, 0.0, 0.0)  # about L: S of the scan lies along P of the CT
    result = scanned_spheres().model_copy(
        update={"ct_from_scan": FusedPose(translation_mm=(1.0, 2.0, 3.0), quaternion_wxyz=quarter_turn)}
    )
    spheres_mm = np.array([[0.0, 60.0, 0.0], [0.0, -60.0, 0.0], [0.0, 0.0, 60.0], [0.0, 0.0, -60.0]])
    target_mm = (0.0, 0.0, -80.0)
    errors = result.scan_errors(spheres_mm, target_mm, np.eye(3))
    along_p_mm, along_s_mm = (np.linalg.norm(errors.at_spheres_mm[one]) for one in (0, 2))
    in_ct = scan_errors(None, spheres_mm, target_mm, np.eye(3))
    assert along_p_mm == pytest.approx(np.linalg.norm(in_ct.at_spheres_mm[2]))  # the table of the scan
    assert along_s_mm == pytest.approx(np.linalg.norm(in_ct.at_spheres_mm[0]))
    at_target_mm2 = errors.at_target_mm @ errors.at_target_mm.T
    np.testing.assert_allclose(at_target_mm2, in_ct.at_target_mm @ in_ct.at_target_mm.T, atol=1e-12)
    both = np.einsum("ik,jk->ij", errors.at_spheres_mm[0], errors.at_target_mm)
    assert np.all(both == 0.0)  # two scanners err independently


def test_no_more_spheres_are_expected_in_the_room_than_the_scan_shows() -> None:
    assert scanned_spheres().count_expected(5) == 4


@pytest.mark.hazard(68)
def test_results_that_stand_in_for_others_are_defined_beside_them_so_that_every_reader_knows_them() -> None:
    for model in (step.result for step in clinical_steps(intraoperative=True)):
        for stand_in in stand_ins(model).values():
            assert stand_in.__module__ == model.__module__


@pytest.mark.hazard(68)
def test_a_record_of_the_scan_is_read_where_spheres_of_the_ct_are_asked_for() -> None:
    result = scanned_spheres()
    record = Record(
        identifier="06-intraoperative_scan",
        kind=result.kind,
        parents={},
        payload=result.model_dump(mode="json", by_alias=True),
        version=result.version,
        run="run",
        series=None,
        trajectory=None,
    )
    (stored,) = results_of(LocalizedFiducials, [record])
    assert stored.result == result


@pytest.mark.hazard(68)
def test_a_person_says_that_the_scan_is_of_the_head_as_clamped_and_a_no_takes_nothing_from_it(
    tmp_path: Path,
) -> None:
    cell = ClinicalCell(tmp_path)
    cell.carrying(MountedTool.STEREO_HEAD).settled()
    cell.operator.refusing = (Topic.SCANNED,)
    clinical = cell.setting().clinical
    assert clinical is not None
    write_slice(clinical.scan_series, draw_scene("default", seed=1000), "20180602")
    engine = cell.begin(
        *(imported_ct(), localized_fiducials(), checked_plan()), done_later(clamped_head()), STEP
    )
    with raises(NotConfirmed, match="made of the head as it is clamped now"):
        engine.run_to()
    (asked,) = [one for one in cell.operator.asked if one.topic is Topic.SCANNED]
    assert asked.value_line.startswith("1 file of 20180602 12:00:00 in ")
    assert asked.value_line.endswith("it was there before this step began")
    assert engine.case.find(IntraoperativeSpheres, None) is None


@pytest.mark.hazard(68)
@pytest.mark.parametrize("share", [0.0, 0.7], ids=["as in the CT", "refitted"])
def test_spheres_that_all_sit_as_in_the_ct_are_asked_about_and_a_no_ends_the_step_without_a_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, share: float
) -> None:
    cell = ClinicalCell(tmp_path)
    cell.carrying(MountedTool.STEREO_HEAD).settled()
    setting = cell.setting()
    assert setting.clinical is not None
    moved_mm = share * setting.settings.seating_error_mm
    write_slice(setting.clinical.scan_series, draw_scene("default", seed=1000), "20180602")
    before = localized_fiducials()
    ways_mm = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
    markers = tuple(
        one.model_copy(update={"centre_mm": vector3(np.array(one.centre_mm) + moved_mm * way_mm)})
        for one, way_mm in zip(before.markers, ways_mm, strict=True)
    )
    pose = PoseEstimate(RigidTransform.identity(), np.zeros(3), 1e-4 * np.eye(6))
    scan = SimpleNamespace(series_instance_uid="1.2.9")
    for name, stand_in in {
        "require_scan_of_operation": None,
        "read_series": scan,
        "localize_whole": Localization(markers, (), "1.2.9", "1.2.10", 11.5),
        "volume_of": None,
        "register_bone": BonePose(pose, 0.9, 6, 6),
        "draw_markers": (b"",) * len(markers),
        "find_unused": (),
    }.items():
        monkeypatch.setattr(intraoperative_scan, name, lambda *_a, _it=stand_in, **_k: _it)
    asked = []

    def answer(question: Question) -> None:  # no to the second question alone
        if question.topic is Topic.SCANNED:
            asked.append(question.subject)
            cell.operator.refusing = (Topic.SCANNED,) if "surely another scan" in question.subject else ()

    cell.operator.meanwhile = answer
    engine = cell.begin(*(imported_ct(), before, checked_plan()), done_later(clamped_head()), STEP)
    if share:
        engine.run_to()
        assert len(asked) == 1
        assert engine.case.get(IntraoperativeSpheres).result.shown == (0, 1, 2, 3)
        return
    with raises(NotConfirmed, match="surely another scan"):
        engine.run_to()
    assert len(asked) == 2
    assert engine.case.find(IntraoperativeSpheres, None) is None


@pytest.mark.hazard(68)
def test_a_sphere_keeps_its_number_of_the_ct_and_a_new_one_comes_after_those() -> None:
    pose = PoseEstimate(RigidTransform.identity(), np.zeros(3), np.eye(6))
    placed = PlacedScan(pose, pose, (SpherePair(0, 3, 0.1, True), SpherePair(2, 0, 0.1, True)))
    assert number_spheres(placed, shown=4, in_ct=4) == (4, 5, 1, 6)


def test_the_record_has_each_sphere_at_its_index_of_the_ct_and_places_of_the_ct_where_none_is_shown() -> None:
    before = localized_fiducials()
    in_ct = before.markers
    new = in_ct[0].model_copy(update={"centre_mm": (1.0, 2.0, 3.0)})
    x_mm, y_mm, z_mm = in_ct[0].centre_mm
    moved = in_ct[0].model_copy(update={"centre_mm": (x_mm + 1.0, y_mm, z_mm)})
    found = Localization((in_ct[3], new, moved), (), "1.2.9", "1.2.10", 11.5)
    pose = PoseEstimate(RigidTransform.identity(), np.zeros(3), 1e-4 * np.eye(6))
    placed = PlacedScan(pose, pose, (SpherePair(0, 3, 0.0, True), SpherePair(2, 0, 1.0, False)))
    bone = BonePose(pose, 0.9, 6, 6)
    result = _record(before, found, "0" * 64, bone, placed, checked_plan(), ())
    assert [one.centre_mm for one in result.markers] == [
        moved.centre_mm,
        *(one.centre_mm for one in in_ct[1:]),
        new.centre_mm,
    ]
    assert result.shown == (0, 3, len(in_ct))
    assert [one.moved_mm for one in result.spheres] == [1.0, 0.0, None]


def test_a_sphere_that_the_scan_does_not_show_keeps_its_number_and_is_not_measured() -> None:
    whole = scanned_spheres()
    result = whole.model_copy(update={"spheres": (*whole.spheres[:1], *whole.spheres[2:])})
    assert list(result.numbered) == [1, 3, 4]
    assert result.count_expected(4) == 3
    assert len(result.markers) == 4


@pytest.mark.hazard(68)
def test_only_a_later_scan_of_the_same_patient_is_taken(tmp_path: Path) -> None:
    scene, other = draw_scene("default", seed=1000), draw_scene("default", seed=1001)
    ct = write_slice(tmp_path / "ct", scene, "20180601", "the CT")
    require_scan_of_operation(ct, write_slice(tmp_path / "later", scene, "20180602"))
    with raises(SCAN_MISSING):
        require_scan_of_operation(ct, tmp_path / "nowhere")
    with raises(NOT_LATER):
        require_scan_of_operation(ct, write_slice(tmp_path / "older", scene, "20180531"))
    with raises(OTHER_PATIENT):
        require_scan_of_operation(ct, write_slice(tmp_path / "other", other, "20180602"))


@pytest.mark.filterwarnings("ignore:Invalid value for VR DA")
@pytest.mark.parametrize(
    ("date", "occasion", "words"),
    [
        ("20180602", "the CT", "frame of reference of the planning CT"),
        ("", "the operation", "the scan has no readable date"),
        ("20181399", "the operation", "got '20181399'"),
        ("2018.05.31", "the operation", "older than the planning CT"),
    ],
)
@pytest.mark.hazard(68)
def test_a_scan_that_is_not_known_to_be_later_is_refused(
    tmp_path: Path, date: str, occasion: str, words: str
) -> None:
    scene = draw_scene("default", seed=1000)
    ct = write_slice(tmp_path / "ct", scene, "20180601", "the CT")
    scan = write_slice(tmp_path / "scan", scene, date, occasion)
    with raises(NOT_LATER, match=words):
        require_scan_of_operation(ct, scan)


@pytest.mark.parametrize(
    ("stated", "is_older"),
    [
        ({"AcquisitionDate": "20180601", "AcquisitionTime": "110000"}, True),
        ({"AcquisitionDate": "20180601", "AcquisitionTime": "150000.25"}, False),
        ({"AcquisitionDate": "20180601", "ContentDate": "20180602"}, False),  # its time is unknown
        ({"AcquisitionDateTime": "20180501100000"}, True),
        ({"AcquisitionDateTime": "20180601150000.5+0400"}, True),  # as the clock of the CT has it, 13:00
        ({"AcquisitionDateTime": "20180601150000", "TimezoneOffsetFromUTC": "+0200"}, False),
    ],
)
def test_a_scan_is_older_by_the_time_and_by_the_first_date_that_is_stated(
    tmp_path: Path, stated: dict[str, str], is_older: bool
) -> None:
    scene = draw_scene("default", seed=1000)
    ct = write_slice(tmp_path / "ct", scene, "20180601", "the CT")
    scan = write_slice(tmp_path / "scan", scene, "20180602")
    of_ct = {"AcquisitionTime": "140000", "TimezoneOffsetFromUTC": "+0200"}
    for folder, attributes in ((ct, of_ct), (scan, stated)):
        for path in folder.iterdir():
            header = dcmread(path)
            header.update(attributes)
            header.save_as(path)
    assert any(words in describe_scan(scan) for words in (":00:00", "at an unknown time"))
    if not is_older:
        require_scan_of_operation(ct, scan)
        return
    with raises(NOT_LATER, match="expected later than 20180601 14:00:00"):
        require_scan_of_operation(ct, scan)


@pytest.mark.hazard(68)
def test_a_scan_of_a_nameless_patient_is_refused(tmp_path: Path) -> None:
    scene = draw_scene("default", seed=1000)
    folders = [
        write_slice(tmp_path / "ct", scene, "20180601", "the CT"),
        write_slice(tmp_path / "scan", scene, "20180602"),
    ]
    for folder in folders:
        for path in folder.iterdir():
            header = dcmread(path)
            header.PatientID = ""
            header.save_as(path)
    with raises(OTHER_PATIENT, match="neither"):
        require_scan_of_operation(*folders)


def test_a_sphere_that_the_field_cuts_off_is_named_by_its_number_in_the_ct() -> None:
    shape = (20, 20, 20)
    geometry = VoxelGeometry(shape, np.zeros(3), np.eye(3)[:, ::-1], np.full(3, 5.0))
    volume = Volume(np.full(shape, -1000, np.int16), geometry, "1.2.3", "1.2.4")
    cut = Candidate((2.0, 50.0, 50.0), accepted=False, reason="is cut off by the field", contrast_hu=900.0)
    found = Localization((), (cut,), "1.2.3", "1.2.4", 11.5)
    marker = scanned_spheres().markers[0]
    places_mm = ((50.0, 50.0, 50.0), (1.0, 50.0, 51.0), (-40.0, 50.0, 50.0), (90.0, 50.0, 50.0))
    before = LocalizedFiducials(
        series_instance_uid="1.2.1",
        diameter_mm=11.5,
        markers=tuple(marker.model_copy(update={"centre_mm": one}) for one in places_mm),
        doubtful=(),
    )
    pose = PoseEstimate(RigidTransform.identity(), np.zeros(3), np.eye(6))
    unused = find_unused(before, volume, found, PlacedScan(pose, pose, (SpherePair(0, 0, 0.1, True),)))
    assert [(one.fiducial, one.reason) for one in unused] == [
        (1, "is cut off by the field"),
        (2, "is outside the field of view"),
        (3, "is not there"),
    ]


def test_a_scan_without_spheres_asks_for_another_one_with_the_field_aimed_at_them() -> None:
    context = SimpleNamespace(
        clinical=SimpleNamespace(methods=CaseMethods()), progress=lambda share, what: None
    )
    shape = (60, 60, 60)
    geometry = VoxelGeometry(shape, np.zeros(3), np.eye(3)[:, ::-1], np.ones(3))
    air = Volume(np.full(shape, -1000, np.int16), geometry, "1.2.3", "1.2.4")
    with raises(TooFewWhole, match="too few whole spheres"):
        localize_whole(cast(StepContext, context), air)
