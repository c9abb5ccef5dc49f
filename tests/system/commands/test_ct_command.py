"""`ronna-ct` as a user runs it: processes, files, terminals."""

from __future__ import annotations

import json
import os
import pty
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pydicom
import pytest
from painted_ct import SERIES_UID, Scan, write_series
from pydicom.dataelem import RawDataElement
from pydicom.encaps import encapsulate
from pydicom.tag import Tag
from pydicom.uid import JPEGLosslessSV1
from spoiled_slices import every, only, setting
from user_commands import in_this_process

from procedures.cli.ct import app
from procedures.imaging.dicom.frame_decoder import FrameDecoder, NotDecoded

COMMAND = [sys.executable, "-P", "-c", "from procedures.cli.ct import main; main()"]
ORIGIN_MM = np.array([10.0, -20.0, 30.0])
CENTRES_MM = np.array([[24.3, -7.1, 47.6], [50.2, -6.4, 52.1]])  # LPS


@pytest.fixture(scope="module")
def series(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two balls in air, written as an axial series that carries a patient's name."""
    scan = Scan(shape=(40, 56, 110), noise_hu=15.0)
    for centre_mm in CENTRES_MM:
        scan.ball((centre_mm - ORIGIN_MM)[::-1])
    folder = tmp_path_factory.mktemp("series")
    return write_series(folder, scan.voxels(), scan.spacing_mm, origin_mm=tuple(ORIGIN_MM))


def ronna_ct(*arguments: object) -> subprocess.CompletedProcess[str]:
    return in_this_process(app, *arguments)


def test_the_json_holds_exactly_what_scripts_rely_on(series: Path) -> None:
    done = ronna_ct("localize", series, "--json", "--expected", 2)
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout)
    assert set(document) == {"markers", "series_instance_uid", "elapsed_s", "deformation"}
    assert set(document["deformation"]) == {"spheres", "strain", "covariance", "chi_square", "limit"}
    assert document["series_instance_uid"] == SERIES_UID
    assert 0.0 < document["elapsed_s"] < 60.0
    keys = {"centre_mm", "covariance_mm2", "radius_mm", "quality", "flags", "odds"}
    assert all(set(marker) == keys for marker in document["markers"])
    centres = np.array([marker["centre_mm"] for marker in document["markers"]])
    np.testing.assert_allclose(centres, CENTRES_MM[::-1], atol=0.02)  # superior first
    for marker in document["markers"]:
        assert np.linalg.eigvalsh(marker["covariance_mm2"]).min() > 0.0
        assert marker["radius_mm"] == pytest.approx(5.75, abs=0.1)
        assert 0.5 < marker["quality"] <= 1.0
        assert marker["flags"] == []
        assert marker["odds"] > 0.9


def test_rough_picks_are_refined_and_flagged(series: Path, tmp_path: Path) -> None:
    spheres, said = tmp_path / "spheres.csv", tmp_path / "spheres.json"
    assert ronna_ct("localize", series, "--write", spheres, "--write", said).returncode == 0
    assert [one["name"] for one in json.loads(said.read_text())["spheres"]] == ["M1", "M2"]
    done = ronna_ct("localize", series, "--pick", spheres, "--expected", 2, "--candidates", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    document = json.loads(done.stdout)
    assert all("picked" in marker["flags"] for marker in document["markers"])
    assert [one["accepted"] for one in document["candidates"]] == [True, True]
    odds = [sorted(one["odds"] for one in document[kind]) for kind in ("markers", "candidates")]
    assert odds[0] == odds[1]


def test_a_scan_without_the_layout_is_refused(series: Path) -> None:
    done = ronna_ct("localize", series, "--layout", "xframe")
    assert done.returncode == 3
    assert "REG-012: the scan does not show the whole layout" in done.stderr


def test_the_layout_is_found_beside_a_ball_of_another_size_which_is_told(tmp_path: Path) -> None:
    placed_mm = np.array([[20.0, 20.0, 15.0], [20.0, 20.0, 31.0], [24.0, 14.0, 53.0]])
    other_mm = (20.0, 21.0, 70.0)
    scan = Scan(shape=(40, 80, 160), noise_hu=15.0)
    for centre_mm in placed_mm:
        scan.ball(centre_mm)
    scan.ball(np.array(other_mm), radius_mm=5.5)
    series = write_series(tmp_path / "ct", scan.voxels(), scan.spacing_mm)
    layout, more = tmp_path / "three.csv", tmp_path / "four.csv"
    np.savetxt(layout, placed_mm[:, ::-1], delimiter=",")
    np.savetxt(more, np.vstack([placed_mm, other_mm])[:, ::-1], delimiter=",")
    done = ronna_ct("localize", series, "--layout", layout)
    assert done.returncode == 0
    assert "the layout was found to 0.0" in done.stderr
    refused = ronna_ct("localize", series, "--layout", more)
    assert refused.returncode == 3
    doubtful, error = refused.stderr.splitlines()
    assert doubtful.startswith("doubtful, not taken: (")
    assert "has radius 5.50 mm" in doubtful
    assert error.startswith("REG-012")


def test_a_layout_of_two_points_is_refused_before_the_series_is_read(tmp_path):
    (tmp_path / "lay.csv").write_text("0,0,0\n30,0,0\n")
    done = ronna_ct("localize", tmp_path / "none", "--layout", tmp_path / "lay.csv")
    assert done.returncode != 0
    assert "CT-018: lay.csv is not a layout; expected at least 3 points, got 2" in done.stderr


@pytest.mark.parametrize("method", ["thesis-line", "thesis-sphere"])
def test_the_thesis_methods_can_be_chosen_but_refine_no_picks(series: Path, method: str) -> None:
    done = ronna_ct("localize", series, "--method", method, "--expected", 2)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.count("covariance_assumed") == 2
    refused = ronna_ct("localize", series, "--method", method, "--pick", "any.csv")
    assert refused.returncode == 2
    assert "Omit --method" in refused.stderr


def test_an_unexpected_count_is_refused_and_every_candidate_listed(series: Path, tmp_path: Path) -> None:
    pictures = tmp_path / "seen"
    done = ronna_ct("localize", series, "--expected", 3, "--candidates", "--json", "--pictures", pictures)
    assert done.returncode == 3
    assert [one["accepted"] for one in json.loads(done.stdout)["candidates"]] == [True, True]
    assert done.stderr.startswith("CT-016: 2 markers found, 3 expected; candidates: (")
    assert done.stderr.count("\n") == 1
    assert sorted(path.name for path in pictures.iterdir()) == ["candidate-1.png", "candidate-2.png"]
    assert ronna_ct("localize", series, "--expected", 3, "--candidates").stdout.count("is a marker") == 2


def test_a_doubtful_sphere_is_told_with_its_reason_and_odds(tmp_path: Path) -> None:
    scan = Scan(shape=(40, 80, 120))
    for place_mm in (20.0, 45.0):
        scan.ball(np.array([20.0, 20.0, place_mm]))
    scan.ball(np.array([20.0, 20.0, 45.0]), 2.8, -1000.0)
    done = ronna_ct("localize", write_series(tmp_path, scan.voxels()))
    (said,) = done.stderr.splitlines()
    assert said.startswith("doubtful, not taken: (25.0, -10.0, 60.0) is doubtful: ")
    assert "of its core is a different material" in said
    assert "(odds 0." in said


def test_without_a_terminal_the_table_is_tab_separated_lines(series: Path) -> None:
    done = ronna_ct("localize", series)
    lines = [line.split("\t") for line in done.stdout.splitlines()]
    assert (done.returncode, done.stderr, len(lines)) == (0, "", 3)
    assert [len(line) for line in lines] == [9, 9, 9]
    np.testing.assert_allclose([float(cell) for cell in lines[1][1:4]], CENTRES_MM[1], atol=0.02)


@pytest.mark.slow
def test_a_terminal_gets_a_drawn_table(series: Path) -> None:
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


@pytest.mark.hazard(35)
def test_no_output_names_the_patient_by_default(series: Path, tmp_path: Path) -> None:
    forms = [tmp_path / f"spheres{ending}" for ending in (".dcm", ".json", ".csv", ".mrk.json")]
    written = [word for path in forms for word in ("--write", path)]
    done = ronna_ct(
        "localize", series, "--verbose", "--candidates", "--pictures", tmp_path / "seen", *written
    )
    assert done.returncode == 0
    pictures = sorted((tmp_path / "seen").iterdir())
    assert [path.name for path in pictures] == ["marker-1.png", "marker-2.png"]
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures)
    everything = [path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()]
    assert len(everything) == len(forms) + 2
    for shown in (done.stdout.encode(), done.stderr.encode(), *everything):
        assert b"secret" not in shown.lower()


@pytest.mark.hazard(35)
def test_the_page_of_a_series_does_not_name_the_patient(series: Path, tmp_path: Path) -> None:
    done = ronna_ct("view", series, "--out", tmp_path / "ct.html")
    assert done.returncode == 0, done.stderr
    page = (tmp_path / "ct.html").read_text()
    assert "marker 2" in page
    assert "secret" not in page.lower()


def test_a_page_replaces_neither_a_slice_nor_a_plan(series: Path, tmp_path: Path) -> None:
    plan = tmp_path / "plan.toml"
    plan.write_text("[plan]\n")
    done = ronna_ct("view", series, "--out", plan)
    assert done.returncode == 1
    assert "CLI-005" in done.stderr
    assert plan.read_text() == "[plan]\n"


def test_the_patient_is_named_on_request(series: Path, tmp_path: Path) -> None:
    asked = ronna_ct("localize", series, "--identity", "--json", "--write", tmp_path / "spheres.dcm")
    patient = json.loads(asked.stdout)["patient"]
    assert patient == {"name": "Secret^Name", "identifier": "SECRET-ID", "birth_date": "", "sex": ""}
    fiducials = pydicom.dcmread(tmp_path / "spheres.dcm")
    assert (fiducials.PatientName, fiducials.PatientID) == ("Secret^Name", "SECRET-ID")
    said = ronna_ct("localize", series, "--identity")
    assert said.stderr == "patient: Secret^Name, identifier SECRET-ID\n"


ANOTHER_SERIES = setting(SeriesInstanceUID="1.2.3.4.5")
SCOUT = setting(ImageType=["ORIGINAL", "PRIMARY", "LOCALIZER"])
IN_COLOUR = setting(SamplesPerPixel=3, PhotometricInterpretation="RGB", PlanarConfiguration=0)


def as_lossless_jpeg(data: pydicom.Dataset) -> None:
    data.file_meta.TransferSyntaxUID = JPEGLosslessSV1
    frame = struct.pack(">HHHBHHB", 0xFFD8, 0xFFC3, 11, 16, data.Rows, data.Columns, 1)  # T.81, annex B
    data.PixelData = encapsulate([frame])
    data["PixelData"].VR = "OB"
    data["PixelData"].is_undefined_length = True


def no_decoder(_decoder: FrameDecoder, _path: Path) -> None:
    raise NotDecoded("no decoder")


def not_a_number(data: pydicom.Dataset) -> None:
    tag = Tag("RescaleSlope")
    data[tag] = RawDataElement(tag, "DS", 4, b"NaN ", 0, False, True)


def test_candidates_beyond_the_listed_ones_are_counted(tmp_path: Path) -> None:
    voxels = np.full((54, 144, 180), -1000, dtype=np.int16)
    for z, y, x in np.ndindex(3, 4, 5):  # cubes of 9 mm
        voxels[5 + 18 * z :, 9 + 36 * y :, 9 + 36 * x :][:9, :18, :18] = 100
    done = ronna_ct("localize", write_series(tmp_path / "many", voxels), "--expected", 3)
    assert (done.returncode, done.stdout) == (3, "")
    assert done.stderr.startswith("CT-016: 0 markers found, 3 expected; candidates: (")
    assert " and 52 less likely. " in done.stderr
    assert done.stderr.count("\n") == 1


def test_bad_input_gives_one_clear_message_with_its_code(
    series: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # as without the extra that decodes compressed slices
    monkeypatch.setattr("procedures.imaging.series.can_decode", lambda syntax: False)
    monkeypatch.setattr(FrameDecoder, "decode", no_decoder)
    voxels = np.zeros((9, 8, 8), dtype=np.int16)
    truncated = write_series(tmp_path / "truncated", voxels)
    os.truncate(truncated / "0005.dcm", 600)
    mixed = write_series(tmp_path / "mixed", voxels, edit=only(7, setting(SeriesInstanceUID="1.2.3.4.5")))
    both = write_series(tmp_path / "both", voxels)
    for path in sorted(write_series(tmp_path / "other", voxels, edit=every(ANOTHER_SERIES)).iterdir()):
        path.rename(both / f"other-{path.name}")
    colour = write_series(tmp_path / "colour", voxels, edit=every(IN_COLOUR))
    compressed = write_series(tmp_path / "compressed", voxels, edit=every(as_lossless_jpeg))
    scout = write_series(
        tmp_path / "scout", voxels, edit=only(0, setting(ImageType=["ORIGINAL", "LOCALIZER"]))
    )
    unscaled = write_series(tmp_path / "unscaled", voxels, edit=only(4, not_a_number))
    frame = tmp_path / "frame.csv"  # of another frame than the two spheres
    frame.write_text("0,0,0\n40,0,0\n0,70,0\n25,25,30\n")
    (tmp_path / "file").write_text("x")
    cases = [
        (["localize", both], 1, "CT-003", "1.2.3.4.5"),
        (["localize", colour], 1, "CT-014", "colour"),
        (["localize", compressed], 1, "CT-013", "ronna-hw[compressed]"),
        (["localize", scout], 1, "CT-021", "0000.dcm"),
        (["localize", unscaled], 1, "CT-012", "RescaleSlope"),
        (["localize", series, "--layout", frame], 3, "REG-012", "all 4 spheres of the layout"),
        (["localize", mixed], 1, "CT-003", "1.2.3.4.5"),
        (["localize", truncated], 1, "CT-005", "0005.dcm"),
        (["localize", series, "--pictures", tmp_path / "file"], 1, "CLI-005", "file"),
    ]
    for arguments, exit_code, code, named in cases:
        done = ronna_ct(*arguments)
        assert (done.returncode, done.stdout) == (exit_code, ""), arguments
        assert done.stderr.startswith(f"{code}: "), done.stderr
        assert named in done.stderr
        assert done.stderr.count("\n") == 1
        assert "secret" not in done.stderr.lower()


def test_the_example_prints_the_centres(series: Path) -> None:
    example = Path(__file__).parents[3] / "examples" / "localize_series.py"
    done = subprocess.run([sys.executable, str(example), str(series)], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert len(lines) == 2
    words = lines[0].split()
    np.testing.assert_allclose([float(words[index]) for index in (2, 4, 6)], CENTRES_MM[1], atol=0.02)


def test_the_name_of_a_slice_cannot_control_the_terminal(series: Path, tmp_path: Path) -> None:
    spoiled = shutil.copytree(series, tmp_path / "\x1b]0;owned\x07")
    slices = sorted(spoiled.iterdir())
    for place, name in ((3, "\x1b[2Jsecond\nline"), (4, "\u202egnp.exe")):
        content = slices[place].read_bytes()
        slices[place].unlink()
        (spoiled / name).write_bytes(content[: len(content) // 2])
    refused = ronna_ct("localize", spoiled)
    assert refused.returncode == 1
    (line,) = refused.stderr.splitlines()
    assert line.isprintable()
    assert "\\x1b[2Jsecond line" in line
