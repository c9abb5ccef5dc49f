"""An MR is registered to the CT rightly, and what cannot be trusted is refused with a reason."""

from __future__ import annotations

import io
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from coded_errors import raises
from PIL import Image
from scipy.spatial.transform import RigidTransform, Rotation

from benchmarks.scans.fusion import GOAL_MM, MR, draw_targets, paint_mr, rms_at_targets_mm
from benchmarks.scans.postoperative import paint_before
from procedures.cli.fuse import check_same_patient
from procedures.fusion import registration
from procedures.fusion.chequerboard import draw_chequerboard
from procedures.fusion.errors import (
    FUSION_MISSING,
    FUSION_UNREADABLE,
    OTHER_PATIENT,
    SAME_SERIES,
    LandmarksDisagree,
    NothingToFuse,
    PartsDisagree,
    StartsDisagree,
)
from procedures.fusion.mutual_information import COARSE_MM, Optimum, build_level, refine_pose
from procedures.fusion.record import (
    LEAST_ERROR_MM,
    FusedPose,
    Fusion,
    expect_errors_mm,
    format_fusion,
    format_itk_transform,
    read_fusion,
)
from procedures.fusion.registration import check_landmarks, fuse_series
from procedures.imaging import Volume
from sim.phantom.mr_scan import MrScan, ct_from_mr, draw_mr
from sim.world.scene.model import CtProtocol, Scene
from sim.world.scene.named_scenes import MINI_CT, draw_scene

SEED = 7
SMALL_CT = CtProtocol(pixel_mm=2.0, slice_mm=3.0, columns=128, rows=128, slices=68)
SMALL_MR = MR.model_copy(update={"pixel_mm": 2.0, "slice_mm": 2.5, "columns": 128, "rows": 128, "slices": 96})
POINTS_MM = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 10.0], [0.0, 70.0, -20.0], [-40.0, 20.0, 60.0]])


@pytest.fixture(scope="module")
def scene() -> Scene:
    return draw_scene("default", seed=SEED).model_copy(update={"ct": SMALL_CT})


@pytest.fixture(scope="module")
def scan(scene: Scene) -> MrScan:
    return draw_mr(scene, SEED, protocol=SMALL_MR, distortion_mm=0.2)


def pose(turn_deg: float = 12.0, shift_mm: float = 25.0) -> RigidTransform:
    rotation = Rotation.from_rotvec([0.0, np.radians(turn_deg), 0.0])
    return RigidTransform.from_components([shift_mm, -5.0, 3.0], rotation)


def fusion_of(*parts: RigidTransform) -> Fusion:
    return Fusion(
        schema=1,
        ct_series_uid="1.2.1",
        other_series_uid="1.2.3",
        other_frame_uid="1.2.3",
        modality="MR",
        ct_from_other=FusedPose.of(pose()),
        parts=tuple(FusedPose.of(one) for one in parts or (pose(), pose())),
        expected_mm=0.3,
        starts=7,
        agreeing_starts=7,
        information=0.8,
        overlap=1.0,
    )


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_an_mr_30_mm_and_20_degrees_off_is_right_within_its_goal_at_the_targets() -> None:
    scene = draw_scene("default", seed=5).model_copy(update={"ct": MINI_CT})
    scan = draw_mr(scene, 5, protocol=MR, distortion_mm=0.3)
    fusion = fuse_series(paint_before(scene), paint_mr(scan), "MR")
    error_mm = rms_at_targets_mm(fusion, scan, draw_targets(scene, 5))
    assert error_mm <= fusion.expected_mm <= GOAL_MM
    assert fusion.agreeing_starts >= registration.FEWEST_AGREEING


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_series_too_coarse_to_agree_with_their_halves_are_refused(scene: Scene, scan: MrScan) -> None:
    with raises(PartsDisagree, match="halves of the head"):
        fuse_series(paint_before(scene), paint_mr(scan), "MR")


def test_a_rough_start_is_led_towards_the_truth_and_every_time_alike(scene: Scene, scan: MrScan) -> None:
    level = build_level(paint_before(scene), paint_mr(scan), COARSE_MM)
    true = RigidTransform.from_matrix(scan.pose.scan_from_head)
    start = RigidTransform.from_components([4.0, -3.0, 5.0], Rotation.identity()) * true
    first, again = (refine_pose(level, start, level.head) for _ in range(2))
    assert np.array_equal(first.other_from_ct.as_matrix(), again.other_from_ct.as_matrix())
    targets_mm = draw_targets(scene, SEED)
    off_mm = first.other_from_ct.apply(targets_mm) - true.apply(targets_mm)
    assert np.linalg.norm(off_mm, axis=1).mean() < 3.5  # from 7 mm; half of a voxel of this level


def test_the_chequerboard_shows_both_series_in_three_planes(scene: Scene, scan: MrScan) -> None:
    true = FusedPose.of(RigidTransform.from_matrix(ct_from_mr(scan)))
    fusion = fusion_of().model_copy(update={"ct_from_other": true})
    drawn = draw_chequerboard(paint_before(scene), paint_mr(scan), fusion, scene.head.centre_ct_mm)
    picture = np.asarray(Image.open(io.BytesIO(drawn)))
    height, width = picture.shape
    assert width > 3 * height
    assert picture[height // 2, height // 2] > 0  # brain, in either series
    assert picture[0, 0] == 0  # air of the CT


def test_the_phantoms_mr_shows_the_head_where_its_truth_says(scene: Scene, scan: MrScan) -> None:
    targets_mm = draw_targets(scene, SEED)
    true = RigidTransform.from_matrix(ct_from_mr(scan))
    off_mm = np.linalg.norm(true.apply(scan.shown_mm(targets_mm)) - targets_mm, axis=1)
    assert 0.0 < off_mm.max() <= 0.2  # of the distortion alone
    middle_mm = scan.shown_mm(np.array([scene.head.centre_ct_mm]))
    brain, air = paint_mr(scan).sample(np.vstack([middle_mm, middle_mm + np.array([0.0, 0.0, 110.0])]), 0.0)
    assert brain > 5.0 * air


def test_without_simple_itk_the_line_that_installs_it_is_named(
    monkeypatch: pytest.MonkeyPatch, small_volume: Volume
) -> None:
    monkeypatch.setitem(sys.modules, "SimpleITK", None)
    with raises(FUSION_MISSING) as refused:
        fuse_series(small_volume, small_volume, "MR")
    assert "pip install 'ronna-hw[fusion]'" in refused.value.advice


@pytest.fixture
def small_volume() -> Volume:
    from procedures.imaging import VoxelGeometry

    geometry = VoxelGeometry((4, 4, 4), np.zeros(3), np.eye(3)[:, ::-1], np.ones(3))
    return Volume(np.zeros((4, 4, 4), np.int16), geometry, "1.2.1", "1.2.1")


def test_a_blank_series_is_refused(small_volume: Volume) -> None:
    blank = replace(small_volume, series_instance_uid="1.2.3")
    with raises(NothingToFuse, match="blank"):
        fuse_series(small_volume, blank, "MR")


def test_one_series_twice_is_refused(small_volume: Volume) -> None:
    with raises(SAME_SERIES):
        fuse_series(small_volume, small_volume, "CT")


@pytest.mark.parametrize(
    ("others", "reason"),
    [
        ([Optimum(pose(), 0.8)] * 2 + [Optimum(pose(30.0), 0.79)], "equally likely"),
        ([Optimum(pose(30.0), 0.5)] * 6, "too few starts"),
    ],
)
def test_starts_that_lead_elsewhere_make_it_refused(others: list[Optimum], reason: str) -> None:
    with raises(StartsDisagree, match=reason):
        registration._require_one_optimum([Optimum(pose(), 0.8), *others], POINTS_MM)


def test_landmarks_of_a_person_catch_a_wrong_pose() -> None:
    there_mm = pose().inv().apply(POINTS_MM)
    check = check_landmarks(FusedPose.of(pose()), POINTS_MM, there_mm)
    assert check.rms_mm == pytest.approx(0.0, abs=1e-9)
    with raises(LandmarksDisagree, match="do not meet"):
        check_landmarks(FusedPose.of(pose(16.0)), POINTS_MM, there_mm)
    with raises(LandmarksDisagree, match="not pairs"):
        check_landmarks(FusedPose.of(pose()), POINTS_MM, there_mm[:3])


def test_the_expected_error_grows_where_the_parts_deviate() -> None:
    equal = fusion_of()
    turned = fusion_of(pose(12.5), pose(11.5))
    near = pose().translation
    far = near + np.array([0.0, 0.0, 80.0])
    assert equal.expect_error_mm(far) == pytest.approx(LEAST_ERROR_MM)
    assert turned.expect_error_mm(near) == pytest.approx(LEAST_ERROR_MM)
    both = expect_errors_mm(turned.ct_from_other, turned.parts, far[None])
    assert both[0] == pytest.approx(np.hypot(80.0 * np.radians(0.5), LEAST_ERROR_MM), rel=1e-3)


def test_a_fusion_is_read_back_and_one_of_another_ct_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "fused.json"
    file.write_bytes(format_fusion(fusion_of()))
    found, digest = read_fusion(file, "1.2.1")
    assert found == fusion_of()
    assert len(digest) == 64
    with raises(FUSION_UNREADABLE, match="another CT"):
        read_fusion(file, "1.2.9")
    file.write_text("{}")
    with raises(FUSION_UNREADABLE, match="not a fusion"):
        read_fusion(file, "1.2.1")


def test_the_transform_for_slicer_maps_points_of_the_ct_as_itk_reads_it(tmp_path: Path) -> None:
    sitk = pytest.importorskip("SimpleITK")
    file = tmp_path / "fused.tfm"
    file.write_text(format_itk_transform(fusion_of()))
    mapped = sitk.ReadTransform(str(file)).TransformPoint((10.0, 20.0, 30.0))
    assert mapped == pytest.approx(pose().inv().apply(np.array([10.0, 20.0, 30.0])))


def test_series_of_two_patients_are_refused_and_an_unnamed_one_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    names = {"ct": "1", "mr": "2", "bare": ""}
    monkeypatch.setattr(
        "procedures.imaging.read_identity",
        lambda folder: SimpleNamespace(identifier=names[folder.name]),
    )
    with raises(OTHER_PATIENT):
        check_same_patient(Path("ct"), Path("mr"))
    assert check_same_patient(Path("ct"), Path("ct")) == ()
    assert "patient identifier" in check_same_patient(Path("ct"), Path("bare"))[0]
