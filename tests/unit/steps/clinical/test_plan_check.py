"""The plan belongs to this CT and these spheres, and its trajectories enter this head."""

from __future__ import annotations

import hashlib
from dataclasses import replace

import numpy as np
import pytest
import tomli_w
from clinical_case import CENTRES_CT_MM, SCENE, ClinicalCell
from coded_errors import raises
from painted_ct import SeriesEdit, write_series
from prepared_results import SERIES, imported_ct, localized_fiducials, plan
from pydicom.dataset import Dataset
from recording_cell import RecordingOperator

from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.journal.errors import GateFailed
from procedures.operator.question import Topic
from procedures.planning.errors import WRONG_SERIES, PlanMistakes, WrongMarkerCount
from procedures.planning.plan_file import describe_seal
from procedures.planning.plan_model import FiducialKind, Plan
from procedures.planning.short_numbers import short_plan_number
from procedures.steps.clinical.fiducial_localization import DoubtfulSphere
from procedures.steps.clinical.plan_check import STEP, CheckedPlan
from ronna_hw.arrays import Array

STRANGER_MM = CENTRES_CT_MM.mean(axis=0) + np.array([0.0, 0.0, 40.0])
SHAPE, VOXEL_MM = (56, 64, 52), 4.0
SOFT_HU, AIR_HU = 40, -1000
ONE_SLICE = np.zeros((1, 4, 4), dtype=np.int16)  # for whose it is


def head_volume(series: str) -> Volume:
    """The head of the scene as an ellipsoid of tissue in air."""
    origin = np.array(SCENE.head.centre_ct_mm) - VOXEL_MM * (np.array(SHAPE[::-1]) - 1) / 2.0
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
    z, y, x = np.meshgrid(*(VOXEL_MM * (np.arange(n) - (n - 1) / 2.0) for n in SHAPE), indexing="ij")
    left, posterior, superior = SCENE.head.semi_axes_mm
    inside = (x / left) ** 2 + (y / posterior) ** 2 + (z / superior) ** 2 < 1.0
    voxels = np.where(inside, SOFT_HU, AIR_HU).astype(np.int16)
    return Volume(voxels, VoxelGeometry(SHAPE, origin, axes, np.full(3, VOXEL_MM)), series, "1.2.3", "HFS")


def checked(
    cell: ClinicalCell,
    planned: Plan | None = None,
    *,
    spheres_mm: Array = CENTRES_CT_MM,
    doubtful: tuple[DoubtfulSphere, ...] = (),
    series: str = SERIES,
    edit: SeriesEdit | None = None,
) -> CheckedPlan:
    """The result of the step on the head of the scene."""
    write_series(cell.series, ONE_SLICE, edit=edit)
    cell.plan.write_text(
        tomli_w.dumps((planned or plan()).model_dump(mode="json", by_alias=True, exclude_none=True))
    )
    spheres = localized_fiducials(spheres_mm).model_copy(update={"doubtful": doubtful})
    engine = cell.begin(imported_ct(), spheres, STEP)
    engine.setting.memory.keep(head_volume(series))
    engine.run_to()
    assert engine.setting.memory.find(Volume) is None, "the largest input is still in memory"
    return cell.case.get(CheckedPlan).result


def test_the_checked_plan_is_stored_with_its_head(cell: ClinicalCell) -> None:
    done = checked(cell)
    assert done.plan == plan()
    assert done.implanted == len(CENTRES_CT_MM)
    assert done.head.centre_mm == pytest.approx(SCENE.head.centre_ct_mm, abs=VOXEL_MM)
    assert done.head.semi_axes_mm == pytest.approx(SCENE.head.semi_axes_mm, rel=0.15)


@pytest.mark.hazard(9)
def test_the_plan_of_another_series_is_refused(cell: ClinicalCell) -> None:
    with raises(WRONG_SERIES):
        checked(cell, series="1.2.3.4")


@pytest.mark.hazard(9)
@pytest.mark.branch("SPHERE_COUNT")
def test_a_different_sphere_count_lists_all_spheres_and_continues_if_the_operator_agrees(
    cell: ClinicalCell,
) -> None:
    done = checked(cell, spheres_mm=np.vstack([CENTRES_CT_MM, STRANGER_MM]))
    question, _patient = cell.operator.asked
    assert question.subject == "the CT shows 5 spheres, 4 were implanted"
    assert question.value.count("radius 5.75 mm, quality 1.00, odds 1.00") == 5
    assert done.implanted == 4
    assert done.warnings[-1] == "the CT shows 5 spheres, 4 were implanted: the operator continued"


@pytest.mark.branch("SPHERE_COUNT")
def test_a_doubtful_sphere_is_shown_with_its_reason_and_odds_when_one_is_missing(cell: ClinicalCell) -> None:
    covered = DoubtfulSphere(centre_mm=(1.0, 2.0, 3.0), reason="is doubtful: ends under its cover", odds=0.45)
    checked(cell, plan().model_copy(update={"implanted": 5}), doubtful=(covered,))
    question, _patient = cell.operator.asked
    spheres, holding = question.value.splitlines()
    assert spheres.endswith("not taken: at (1.0, 2.0, 3.0) mm, is doubtful: ends under its cover, odds 0.45")
    assert holding == "hold: nothing moves, the step ends, and every result is kept"


def test_a_ct_with_fewer_spheres_than_implanted_is_accepted_if_the_operator_agrees(
    cell: ClinicalCell,
) -> None:
    assert checked(cell, plan().model_copy(update={"implanted": 5})).implanted == 4


@pytest.mark.branch("SPHERE_COUNT")
def test_a_different_sphere_count_is_refused_if_the_operator_declines(cell: ClinicalCell) -> None:
    cell.operator = RecordingOperator(Topic.SPHERE_COUNT)
    with pytest.raises(WrongMarkerCount):
        checked(cell, spheres_mm=np.vstack([CENTRES_CT_MM, STRANGER_MM]))


def test_too_few_spheres_are_refused_without_asking(cell: ClinicalCell) -> None:
    with pytest.raises(WrongMarkerCount):
        checked(cell, spheres_mm=CENTRES_CT_MM[:3])
    assert cell.operator.asked == []


def test_an_invalid_plan_is_refused_and_its_file_named(cell: ClinicalCell) -> None:
    cell.plan.write_text("schema = 1\n")
    engine = cell.begin(imported_ct(), localized_fiducials(), STEP)
    with pytest.raises(PlanMistakes, match=r"plan\.toml"):
        engine.run_to()


@pytest.mark.hazard(1)
def test_a_plan_whose_trajectories_changed_since_the_case_was_opened_is_refused(cell: ClinicalCell) -> None:
    first, *others = plan().trajectories
    renamed = plan().model_copy(update={"trajectories": (first.model_copy(update={"id": "T9"}), *others)})
    with pytest.raises(GateFailed, match="trajectories have changed since the case was opened"):
        checked(cell, renamed)


def test_a_plan_that_changed_since_the_case_was_opened_is_refused(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    setting = cell.setting()
    assert setting.clinical is not None
    opened = replace(setting, clinical=replace(setting.clinical, plan_sha256="of another"))
    monkeypatch.setattr(cell, "setting", lambda: opened)
    with pytest.raises(GateFailed, match="the plan has changed since the case was opened"):
        checked(cell)


def test_patient_and_plan_are_asked_about_with_the_identity_apart_and_the_plans_pictures(
    cell: ClinicalCell,
) -> None:
    def dated(data: Dataset, _number: int) -> None:
        data.StudyDate = "20260102"

    checked(cell, edit=dated)
    (question,) = cell.operator.asked
    assert question.topic is Topic.PATIENT
    assert question.identity is not None
    assert question.identity.rows == (
        ("name", "Secret, Name"),
        ("identifier", "SECR…, the rest as on the wristband"),
        ("date of scan", "2026-01-02"),
        ("study", "not given"),
    )
    kept = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in cell.folder.rglob("*.png")}
    assert {one.name: one.sha256 for one in question.pictures} == kept
    assert "Secret" not in question.value + repr(question)
    assert all(f", {one.depth_mm:.1f} mm deep" in question.value for one in plan().trajectories)
    assert SERIES not in question.value
    assert f"plan {short_plan_number(plan())}, {describe_seal(plan())}" in question.value.splitlines()


def test_the_question_about_the_plan_says_that_the_skin_is_registered(cell: ClinicalCell) -> None:
    on_skin = plan().model_copy(update={"fiducials": FiducialKind.MIXED, "implanted": 2})
    checked(cell, on_skin, spheres_mm=CENTRES_CT_MM[:2])
    (question,) = cell.operator.asked
    assert "registered on the skin and by 2 spheres" in question.value.splitlines()


@pytest.mark.hazard(7)
@pytest.mark.parametrize(("sign", "side"), [(1.0, "left to right"), (-1.0, "right to left")])
def test_the_side_of_each_trajectory_is_confirmed(cell: ClinicalCell, sign: float, side: str) -> None:
    middle_mm = SCENE.head.centre_ct_mm[0]

    def seen(point_mm: tuple[float, float, float]) -> tuple[float, float, float]:
        return (middle_mm + sign * (point_mm[0] - middle_mm), *point_mm[1:])

    first, second = (
        one.model_copy(update={"entry_mm": seen(one.entry_mm), "target_mm": seen(one.target_mm)})
        for one in plan().trajectories
    )
    checked(cell, plan().model_copy(update={"trajectories": (first, second)}))
    (question,) = cell.operator.asked
    assert f"{first.id} middle, {first.depth_mm:.1f} mm deep, entry at the front\n" in question.value
    assert f"\n{second.id} {side}, " in question.value


@pytest.mark.hazard(7)
def test_a_doubt_about_the_signs_of_the_coordinates_is_asked_before_anything_else(
    cell: ClinicalCell, monkeypatch: pytest.MonkeyPatch
) -> None:
    doubt = "the coordinates may be in RAS"
    monkeypatch.setattr("procedures.planning.plan_check.doubt_signs", lambda *_: doubt)
    checked(cell)
    (question,) = cell.operator.asked
    assert question.value.splitlines()[0] == doubt
    assert doubt in cell.case.get(CheckedPlan).result.warnings


@pytest.mark.hazard(9)
def test_the_patient_identifier_of_the_ct_is_read_back_but_never_written(cell: ClinicalCell) -> None:
    checked(cell)
    (question,) = cell.operator.asked
    assert question.read_back is not None
    assert question.read_back.value == "SECRET-ID"
    assert all("SECRET" not in path.read_text() for path in cell.folder.rglob("*.json*"))


@pytest.mark.hazard(9)
def test_a_ct_without_an_identifier_is_a_finding(cell: ClinicalCell) -> None:
    def anonymous(data: Dataset, _number: int) -> None:
        data.PatientID = ""

    checked(cell, edit=anonymous)
    assert cell.operator.asked[0].read_back is None
    assert len(cell.entries("finding")) == 1
