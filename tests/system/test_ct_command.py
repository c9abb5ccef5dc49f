"""`ronna-ct` as a user meets it: processes, files, terminals."""

from __future__ import annotations

import json
import os
import pty
import subprocess
import sys
from pathlib import Path

import numpy as np
import pydicom
import pytest
from pydicom.dataset import Dataset, FileMetaDataset
from pydicom.uid import CTImageStorage, ExplicitVRLittleEndian
from scipy.special import erfc
from user_commands import in_this_process

from procedures.cli.ct import app

COMMAND = [sys.executable, "-P", "-c", "from procedures.cli.ct import main; main()"]
SPACING_MM = (1.0, 0.5, 0.5)
ORIGIN_MM = np.array([10.0, -20.0, 30.0])
CENTRES_MM = np.array([[24.3, -7.1, 47.6], [50.2, -6.4, 52.1]])  # LPS
SERIES_UID = "1.2.826.0.1.3680043.8.498.77"


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two blurred balls in air, written as an axial series that carries a patient's name."""
    folder = tmp_path_factory.mktemp("series")
    slices, rows, columns = np.meshgrid(*(np.arange(n) for n in (40, 56, 110)), indexing="ij")
    places = ORIGIN_MM + np.stack([columns * 0.5, rows * 0.5, slices * 1.0], axis=-1)
    image = np.full(places.shape[:3], -1000.0)
    for centre in CENTRES_MM:
        depth = np.linalg.norm(places - centre, axis=-1) - 5.75
        image += 1150.0 * 0.5 * erfc(depth / (np.sqrt(2.0) * 0.5))
    image += np.random.default_rng(3).normal(0.0, 15.0, image.shape)
    for number, plane in enumerate(np.rint(image).astype("<i2")):
        data = Dataset()
        data.file_meta, data.preamble = FileMetaDataset(), b"\0" * 128
        data.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
        data.file_meta.MediaStorageSOPClassUID = data.SOPClassUID = CTImageStorage
        data.file_meta.MediaStorageSOPInstanceUID = data.SOPInstanceUID = f"{SERIES_UID}.{number + 1}"
        data.SeriesInstanceUID, data.FrameOfReferenceUID = SERIES_UID, f"{SERIES_UID}.0"
        data.Modality, data.PatientName, data.PatientID = "CT", "Secret^Name", "SECRET-ID"
        data.ImagePositionPatient = [*(float(v) for v in ORIGIN_MM[:2]), float(ORIGIN_MM[2] + number)]
        data.ImageOrientationPatient = [1, 0, 0, 0, 1, 0]
        data.PixelSpacing, data.SliceThickness = [0.5, 0.5], 1.0
        data.RescaleSlope, data.RescaleIntercept = 1, 0
        data.SamplesPerPixel, data.PhotometricInterpretation = 1, "MONOCHROME2"
        data.Rows, data.Columns = plane.shape
        data.BitsAllocated, data.BitsStored, data.HighBit, data.PixelRepresentation = 16, 16, 15, 1
        data.PixelData = plane.tobytes()
        data.save_as(folder / f"{number:03d}.dcm", enforce_file_format=True)
    return folder


def ronna_ct(*arguments: object) -> subprocess.CompletedProcess[str]:
    return subprocess.run([*COMMAND, *map(str, arguments)], capture_output=True, text=True, timeout=150)


def test_json_holds_exactly_what_scripts_rely_on(series: Path) -> None:
    done = ronna_ct("localize", series, "--json", "--expected", 2)
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout)
    assert set(document) == {"markers", "series_instance_uid", "elapsed_s"}
    assert document["series_instance_uid"] == SERIES_UID
    assert 0.0 < document["elapsed_s"] < 60.0
    keys = {"centre_mm", "covariance_mm2", "radius_mm", "quality", "flags"}
    assert all(set(marker) == keys for marker in document["markers"])
    centres = np.array([marker["centre_mm"] for marker in document["markers"]])
    np.testing.assert_allclose(centres, CENTRES_MM[::-1], atol=0.02)  # superior first
    for marker in document["markers"]:
        assert np.linalg.eigvalsh(marker["covariance_mm2"]).min() > 0.0
        assert marker["radius_mm"] == pytest.approx(5.75, abs=0.1)
        assert 0.5 < marker["quality"] <= 1.0
        assert marker["flags"] == []


def test_rough_picks_are_refined_and_flagged(series: Path, tmp_path: Path) -> None:
    spheres, told = tmp_path / "spheres.csv", tmp_path / "spheres.json"
    assert ronna_ct("localize", series, "--write", spheres, "--write", told).returncode == 0
    assert [one["name"] for one in json.loads(told.read_text())["spheres"]] == ["M1", "M2"]
    done = ronna_ct("localize", series, "--pick", spheres, "--expected", 2, "--candidates", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout)
    assert all("picked" in marker["flags"] for marker in document["markers"])
    assert [one["accepted"] for one in document["candidates"]] == [True, True]


def test_the_thesis_method_can_be_chosen_but_refines_no_picks(series: Path) -> None:
    done = ronna_ct("localize", series, "--method", "thesis-sphere", "--expected", 2)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("covariance_assumed") == 2
    refused = ronna_ct("localize", series, "--method", "thesis-line", "--pick", "any.csv")
    assert refused.returncode == 2
    assert "leave --method out" in refused.stderr


def test_a_wrong_count_shows_every_candidate_when_asked(series: Path, tmp_path: Path) -> None:
    done = ronna_ct("localize", series, "--expected", 3, "--candidates", "--pictures", tmp_path / "seen")
    assert done.returncode == 3
    assert done.stdout.count("is a marker") == 2
    assert sorted(path.name for path in (tmp_path / "seen").iterdir()) == [
        "candidate-1.png",
        "candidate-2.png",
    ]
    as_json = ronna_ct("localize", series, "--expected", 3, "--candidates", "--json")
    assert as_json.returncode == 3
    assert [one["accepted"] for one in json.loads(as_json.stdout)["candidates"]] == [True, True]


def test_off_a_terminal_the_table_is_lines_of_fields(series: Path) -> None:
    done = ronna_ct("localize", series)
    lines = [line.split("\t") for line in done.stdout.splitlines()]
    assert (done.returncode, done.stderr, len(lines)) == (0, "", 3)
    assert [len(line) for line in lines] == [9, 9, 9]
    np.testing.assert_allclose([float(cell) for cell in lines[1][1:4]], CENTRES_MM[1], atol=0.02)


def test_on_a_terminal_there_is_a_table(series: Path) -> None:
    controller, terminal = pty.openpty()
    with subprocess.Popen([*COMMAND, "localize", str(series)], stdout=terminal, stderr=terminal) as child:
        os.close(terminal)
        shown = b""
        while True:
            try:
                piece = os.read(controller, 4096)
            except OSError:  # the other end is closed
                break
            if not piece:
                break
            shown += piece
    os.close(controller)
    assert child.returncode == 0
    text = shown.decode()
    assert "2 markers, LPS" in text
    assert "┃" in text


def test_pictures_are_written_into_a_new_folder(series: Path, tmp_path: Path) -> None:
    folder = tmp_path / "new" / "pictures"
    assert ronna_ct("localize", series, "--pictures", folder).returncode == 0
    pictures = sorted(folder.iterdir())
    assert [path.name for path in pictures] == ["marker-1.png", "marker-2.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)


@pytest.mark.hazard(35)
def test_nobody_is_named_unless_asked_for(series: Path, tmp_path: Path) -> None:
    forms = [tmp_path / f"spheres{ending}" for ending in (".dcm", ".json", ".csv", ".mrk.json")]
    written = [word for path in forms for word in ("--write", path)]
    done = ronna_ct(
        "localize", series, "--verbose", "--candidates", "--pictures", tmp_path / "seen", *written
    )
    assert done.returncode == 0
    everything = [path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()]
    assert len(everything) == len(forms) + 2
    for shown in (done.stdout.encode(), done.stderr.encode(), *everything):
        assert b"secret" not in shown.lower()


def test_the_patient_is_named_to_who_asks(series: Path, tmp_path: Path) -> None:
    asked = ronna_ct("localize", series, "--identity", "--json", "--write", tmp_path / "spheres.dcm")
    patient = json.loads(asked.stdout)["patient"]
    assert patient == {"name": "Secret^Name", "identifier": "SECRET-ID", "birth_date": "", "sex": ""}
    fiducials = pydicom.dcmread(tmp_path / "spheres.dcm")
    assert (fiducials.PatientName, fiducials.PatientID) == ("Secret^Name", "SECRET-ID")
    told = ronna_ct("localize", series, "--identity")
    assert told.stderr == "patient: Secret^Name, identifier SECRET-ID\n"


def test_another_count_is_refused_with_the_candidates(series: Path) -> None:
    done = ronna_ct("localize", series, "--expected", 3, "--json")
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith("CT-016: 2 markers found, 3 expected; candidates: (")
    assert done.stderr.count("\n") == 1


def copy_of(series: Path, folder: Path) -> Path:
    folder.mkdir()
    for path in series.iterdir():
        (folder / path.name).symlink_to(path)
    return folder


def test_bad_input_is_one_clear_message_with_its_code(series: Path, tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    truncated = copy_of(series, tmp_path / "truncated")
    whole = (truncated / "005.dcm").read_bytes()
    (truncated / "005.dcm").unlink()
    (truncated / "005.dcm").write_bytes(whole[: len(whole) // 2])
    mixed = copy_of(series, tmp_path / "mixed")
    data = pydicom.dcmread(mixed / "007.dcm")
    data.SeriesInstanceUID = "1.2.3.4.5"
    (mixed / "007.dcm").unlink()
    data.save_as(mixed / "007.dcm")
    (tmp_path / "file").write_text("x")
    cases = [
        (["localize", tmp_path / "missing"], 1, "CT-001", "does not exist"),
        (["localize", tmp_path / "file"], 1, "CT-001", "is not a folder"),
        (["localize", tmp_path / "empty"], 1, "CT-002", "no DICOM image"),
        (["localize", mixed], 1, "CT-003", "1.2.3.4.5"),
        (["localize", truncated], 1, "CT-005", "005.dcm"),
        (["localize", series, "--diameter-mm", "0"], 1, "CT-017", "0 mm"),
        (["localize", series, "--pictures", tmp_path / "file"], 1, "CLI-005", "file"),
        (["localize", series, "--expected", "some"], 2, "CLI-001", "--expected"),
        (["localize"], 2, "CLI-001", "SERIES_DIR"),
        (["measure"], 2, "CLI-001", "measure"),
    ]
    for arguments, exit_code, code, named in cases:
        done = in_this_process(app, *arguments)
        assert (done.returncode, done.stdout) == (exit_code, ""), arguments
        assert done.stderr.startswith(f"{code}: "), done.stderr
        assert named in done.stderr
        assert done.stderr.count("\n") == 1
        assert "secret" not in done.stderr.lower()


def test_help_imports_nothing_heavy() -> None:
    script = (
        "import sys; from ronna_hw.command_line.console import exit_code_of; "
        "from procedures.cli.ct import app; "
        "code = exit_code_of(app, ['localize', '--help']); "
        "print(code, sorted({'numpy', 'scipy', 'pydicom', 'cv2', 'matplotlib'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-P", "-c", script], capture_output=True, text=True)
    assert done.stdout.splitlines()[-1] == "0 []"
    assert "--expected" in done.stdout


def test_the_example_prints_the_centres(series: Path) -> None:
    example = Path(__file__).parents[2] / "examples" / "localize_series.py"
    done = subprocess.run([sys.executable, str(example), str(series)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert len(lines) == 2
    words = lines[0].split()
    np.testing.assert_allclose([float(words[index]) for index in (2, 4, 6)], CENTRES_MM[1], atol=0.02)


@pytest.mark.parametrize("seed", [3, pytest.param(11, marks=pytest.mark.slow)])
def test_the_spheres_of_a_scanned_phantom_are_found_where_they_are(tmp_path: Path, seed: int) -> None:
    phantom = [sys.executable, "-P", "-c", "from sim.cli import main; main()", "phantom"]
    out = tmp_path / "case"
    scanned = subprocess.run(
        [*phantom, "--out", str(out), "--scene", "mini", "--markers", "5", "--seed", str(seed)],
        capture_output=True,
        text=True,
    )
    assert (scanned.returncode, scanned.stderr) == (0, "")
    done = ronna_ct("localize", out / "ct", "--expected", 5, "--json")
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout)
    truth = json.loads((out / "truth.json").read_text())
    assert document["series_instance_uid"] == truth["series_instance_uid"]
    for sphere in truth["fiducials"]:
        errors = [np.subtract(marker["centre_mm"], sphere["centre_mm"]) for marker in document["markers"]]
        nearest = min(range(len(errors)), key=lambda index: float(np.linalg.norm(errors[index])))
        assert np.linalg.norm(errors[nearest]) < 0.025
        covariance = np.array(document["markers"][nearest]["covariance_mm2"])
        assert errors[nearest] @ np.linalg.solve(covariance, errors[nearest]) < 25.0  # chi², 3 degrees
