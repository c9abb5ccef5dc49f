"""The files of a phantom case, byte for byte from the seed, and the patient ID that names scene and seed."""

from __future__ import annotations

import hashlib
import json
import os
import signal
import tomllib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pydicom
import pytest
from coded_errors import raises
from pydicom.uid import JPEGLSLossless

from procedures.imaging.errors import WRONG_MODALITY
from procedures.imaging.series import read_other_series, read_series
from ronna_hw.host.child_process import ChildNotReady
from ronna_hw.host.forked_process import fork_worker
from ronna_hw.phantom_identity import LARGEST_ID, format_patient_id, parse_patient_id
from sim.phantom import case as phantom_case
from sim.phantom.case import PhantomCase, write_case, write_mr
from sim.phantom.mr_scan import PROTOCOL, draw_mr
from sim.phantom.scanner import dicom_series
from sim.world.scene.model import Scene


def digest(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


@pytest.fixture(scope="module")
def case(coarse_scene: Scene, tmp_path_factory: pytest.TempPathFactory) -> PhantomCase:
    return write_case(coarse_scene, tmp_path_factory.mktemp("case"))


def test_the_same_scene_gives_the_same_bytes_and_another_seed_a_different_series(
    coarse_scene: Scene, tmp_path: Path
) -> None:
    write_case(coarse_scene, tmp_path / "a")
    write_case(coarse_scene, tmp_path / "b")
    other = write_case(coarse_scene.model_copy(update={"seed": 9}), tmp_path / "c")
    assert digest(tmp_path / "a") == digest(tmp_path / "b")
    first = tomllib.loads((tmp_path / "a" / "plan.toml").read_text())
    assert first["series_instance_uid"] != other.series_instance_uid


def test_the_series_is_a_ct_with_complete_geometry(case: PhantomCase) -> None:
    truth = json.loads(case.truth.read_text())
    slices = [pydicom.dcmread(path) for path in sorted(case.series.glob("*.dcm"))]
    assert len(slices) == case.slices == 52
    assert {one.SeriesInstanceUID for one in slices} == {case.series_instance_uid}
    assert len({one.SOPInstanceUID for one in slices}) == 52
    assert len({one.FrameOfReferenceUID for one in slices}) == 1
    for number, one in enumerate(slices):
        assert one.Modality == "CT"
        assert one.PatientPosition == "HFS"
        assert [float(value) for value in one.ImageOrientationPatient] == [1, 0, 0, 0, 1, 0]
        x, y, z = truth["first_voxel_mm"]
        wanted = (x, y, z + 4.0 * number)
        assert np.allclose([float(value) for value in one.ImagePositionPatient], wanted, atol=1e-6)
        assert (float(one.RescaleIntercept), float(one.RescaleSlope)) == (-1024.0, 1.0)
        assert one.pixel_array.shape == (128, 128)
        assert one.pixel_array.max() <= 4095


def test_a_long_series_is_stored_as_jpeg_ls_without_loss_and_every_time_alike(
    coarse_scene: Scene, case: PhantomCase, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(dicom_series, "COMPRESSED_BYTES", 0)
    small = write_case(coarse_scene, tmp_path / "a").series
    write_case(coarse_scene, tmp_path / "b")
    assert digest(tmp_path / "a") == digest(tmp_path / "b")
    for path in sorted(small.glob("*.dcm")):
        one, plain = pydicom.dcmread(path), pydicom.dcmread(case.series / path.name)
        assert one.file_meta.TransferSyntaxUID == JPEGLSLossless
        assert len(one.PixelData) < 0.6 * len(plain.PixelData)
        np.testing.assert_array_equal(one.pixel_array, plain.pixel_array)
    np.testing.assert_array_equal(read_series(small).voxels, read_series(case.series).voxels)


def test_the_plan_matches_the_scene(coarse_scene: Scene, case: PhantomCase) -> None:
    plan = tomllib.loads(case.plan.read_text())
    target = coarse_scene.head.targets[0]
    trajectory = {
        "id": target.identifier,
        "entry_mm": list(target.entry_ct_mm),
        "target_mm": list(target.target_ct_mm),
        "free_angle_deg": target.free_angle_deg,
        "margin_mm": target.margin_mm,
    }
    wanted = {
        "schema": 1,
        "series_instance_uid": case.series_instance_uid,
        "patient_orientation": "HFS",
        "implanted": len(coarse_scene.head.fiducials),
        "fiducials": "free",
        "tool": "guide",
        "trajectories": [trajectory],
    }
    assert {key: plan[key] for key in wanted} == wanted


def test_the_truth_lists_every_sphere(coarse_scene: Scene, case: PhantomCase) -> None:
    truth = json.loads(case.truth.read_text())
    wanted = [list(fiducial.centre_ct_mm) for fiducial in coarse_scene.head.fiducials]
    assert [fiducial["centre_mm"] for fiducial in truth["fiducials"]] == wanted
    assert {fiducial["post_material"] for fiducial in truth["fiducials"]} <= {"metal", "polymer"}


def test_slices_of_an_earlier_scan_are_removed(coarse_scene: Scene, tmp_path: Path) -> None:
    (tmp_path / "ct").mkdir()
    (tmp_path / "ct" / "slice-0999.dcm").write_bytes(b"old")
    (tmp_path / "ct" / "notes.txt").write_text("mine")
    write_case(coarse_scene, tmp_path)
    assert not (tmp_path / "ct" / "slice-0999.dcm").exists()
    assert (tmp_path / "ct" / "notes.txt").exists()


def test_progress_increases_to_one(coarse_scene: Scene, tmp_path: Path) -> None:
    shares: list[float] = []
    write_case(coarse_scene, tmp_path, shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0


class Interrupted(BaseException):
    pass


def test_an_interrupted_scan_leaves_no_slices(coarse_scene: Scene, tmp_path: Path) -> None:
    def interrupt(share: float) -> None:
        if share > 0.9:
            raise Interrupted

    with pytest.raises(Interrupted):
        write_case(coarse_scene, tmp_path, interrupt)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("number", "said"),
    [(signal.SIGKILL, "killed by SIGKILL"), (signal.SIGSTOP, "without using the processor")],
    ids=["killed", "halted"],
)
def test_a_scan_whose_second_process_is_killed_or_halted_ends_with_a_code(
    coarse_scene: Scene,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    number: signal.Signals,
    said: str,
) -> None:
    def fork_and_signal(work: Callable[[], None]) -> int:
        def signalled() -> None:
            os.kill(os.getpid(), number)
            work()

        return fork_worker(signalled)

    monkeypatch.setattr(phantom_case, "fork_worker", fork_and_signal)
    monkeypatch.setattr(phantom_case, "IDLE_TIMEOUT_S", 0.5)
    with pytest.raises(ChildNotReady, match=said):
        write_case(coarse_scene, tmp_path)
    assert not list(tmp_path.iterdir())


def test_scene_and_seed_are_read_back_from_the_patient_id() -> None:
    assert format_patient_id("mini", 7) == "mini-7"
    assert parse_patient_id(format_patient_id("our-scene", 7)) == ("our-scene", 7)


def test_a_long_scene_name_leaves_the_seed_whole() -> None:
    patient_id = format_patient_id("s" * 100, 65535)
    assert len(patient_id) == LARGEST_ID
    assert parse_patient_id(patient_id) == ("s" * 58, 65535)


@pytest.mark.parametrize("patient_id", ["", "4711", "-7", "Novak-A", "mini-"])
def test_the_id_of_another_patient_names_no_scene(patient_id: str) -> None:
    assert parse_patient_id(patient_id) is None


def test_the_mr_is_of_the_same_patient_in_a_frame_of_its_own_and_never_read_as_a_ct(
    coarse_scene: Scene, case: PhantomCase, tmp_path: Path
) -> None:
    coarse = PROTOCOL.model_copy(update={"pixel_mm": 4.0, "slice_mm": 6.0, "columns": 64, "rows": 64})
    folder = write_mr(draw_mr(coarse_scene, 3, protocol=coarse.model_copy(update={"slices": 40})), tmp_path)
    volume, modality = read_other_series(folder)
    ct = read_series(case.series)
    assert modality == "MR"
    assert volume.frame_of_reference_uid != ct.frame_of_reference_uid
    one, other = (pydicom.dcmread(next(where.iterdir())) for where in (folder, case.series))
    assert one.PatientID == other.PatientID
    with raises(WRONG_MODALITY, match="expected CT"):
        read_series(folder)
