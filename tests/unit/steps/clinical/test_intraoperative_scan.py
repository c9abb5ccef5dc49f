"""A scan of the clamped head stands in for the spheres of the CT, and only one of the operation is taken."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises

from procedures.engine.case import results_of
from procedures.fusion.record import FusedPose
from procedures.imaging.markers import Marker
from procedures.intraoperative.errors import NOT_LATER, OTHER_PATIENT, SCAN_MISSING
from procedures.steps.catalogue import CLINICAL_STEPS, clinical_steps
from procedures.steps.clinical.fiducial_localization import LocalizedFiducials
from procedures.steps.clinical.intraoperative_scan import (
    PLACE,
    IntraoperativeSpheres,
    ScannedSphere,
    require_scan_of_operation,
)
from ronna_hw.records import Record
from sim.phantom.scanner.dicom_series import DicomSeries
from sim.phantom.scanner.grid import CtGrid
from sim.world.scene.model import CtProtocol, Scene
from sim.world.scene.named_scenes import draw_scene

TINY = CtProtocol(pixel_mm=1.0, slice_mm=1.0, columns=16, rows=16, slices=1)
SCAN_SIGMA_MM = 0.02
PLACE_SIGMA_MM = 0.1


def scanned() -> IntraoperativeSpheres:
    marker = Marker(
        centre_mm=(10.0, 0.0, 90.0),
        covariance_mm2=tuple(tuple(row) for row in (SCAN_SIGMA_MM**2 * np.eye(3)).tolist()),
        radius_mm=5.75,
        quality=1.0,
        agreement_mm=0.01,
        flags=(),
        odds=1.0,
    )
    sphere = ScannedSphere(
        in_scan_mm=(1.0, 2.0, 3.0), sigma_mm=0.03, is_cut=False, ct_sphere=0, moved_mm=0.7, agrees=False
    )
    covariance = np.diag([1e-6] * 3 + [PLACE_SIGMA_MM**2] * 3)
    return IntraoperativeSpheres(
        series_instance_uid="1.2.3",
        diameter_mm=11.5,
        markers=(marker,) * 4,
        doubtful=(),
        ct_from_scan=FusedPose(translation_mm=(1.0, 2.0, 3.0), quaternion_wxyz=(1.0, 0.0, 0.0, 0.0)),
        place_middle_mm=(0.0, 0.0, 0.0),
        place_covariance=tuple(tuple(row) for row in covariance.tolist()),
        bone_agreement=0.95,
        agreeing_starts=6,
        starts=6,
        spheres=(sphere,) * 4,
        expected_mm={"T1": 0.17},
    )


def write_slice(folder: Path, scene: Scene, date: str) -> Path:
    grid = CtGrid((0.0, 0.0, 0.0), 1.0, 1.0, 16, 16, 1)
    series = DicomSeries(scene.model_copy(update={"ct": TINY}), grid, folder, date=date)
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
    result = scanned()
    assert result.seating_mm(0.05) == 0.0
    (place,) = result.place_errors((0.0, 0.0, 0.0), np.eye(3), 4)
    assert place.name == PLACE
    assert np.all(place.at_spheres_mm == 0.0)
    variance_mm2 = float(np.sum(np.asarray(place.at_target_mm) ** 2))
    assert variance_mm2 == pytest.approx(3.0 * PLACE_SIGMA_MM**2)


def test_no_more_spheres_are_expected_in_the_room_than_the_scan_shows() -> None:
    assert scanned().count_expected(5) == 4


def test_a_record_of_the_scan_is_read_where_spheres_of_the_ct_are_asked_for() -> None:
    result = scanned()
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


def test_only_a_later_scan_of_the_same_patient_is_taken(tmp_path: Path) -> None:
    scene, other = draw_scene("default", seed=1000), draw_scene("default", seed=1001)
    ct = write_slice(tmp_path / "ct", scene, "20180601")
    require_scan_of_operation(ct, write_slice(tmp_path / "later", scene, "20180602"))
    with raises(SCAN_MISSING):
        require_scan_of_operation(ct, tmp_path / "nowhere")
    with raises(NOT_LATER):
        require_scan_of_operation(ct, write_slice(tmp_path / "older", scene, "20180531"))
    with raises(OTHER_PATIENT):
        require_scan_of_operation(ct, write_slice(tmp_path / "other", other, "20180602"))
