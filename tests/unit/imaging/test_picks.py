"""A person's rough picks are refined to the nearby sphere, and refused where there is none."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from coded_errors import raises
from localized_spheres import as_volume
from painted_ct import Scan

from procedures.imaging import Volume, errors, localize, localize_picks, read_picks
from ronna_hw.arrays import Array

CENTRES = np.array([[20.2, 19.7, 17.4], [21.1, 20.3, 44.6]])


@pytest.fixture(scope="module")
def volume() -> Volume:
    """Two markers; the patient's axes are turned and shifted against the voxels'."""
    scan = Scan(shape=(40, 80, 120))
    for centre in CENTRES:
        scan.marker(centre, np.array([0.3, 1.0, 0.2]), skin=False)
    axes = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    return as_volume(scan, (100.0, -50.0, 10.0), axes)


def truth(volume: Volume) -> Array:
    return volume.geometry.grid_mm_to_patient_mm(CENTRES)


@pytest.mark.parametrize(
    "error_mm", [(2.0, -2.0, 2.0), pytest.param((-4.0, 0.0, 2.0), marks=pytest.mark.slow)]
)
def test_a_rough_pick_is_refined_to_the_detected_centre(volume: Volume, error_mm: tuple[float, ...]) -> None:
    picked = localize_picks(volume, truth(volume)[:1] + error_mm, expected=1)
    detected = localize(volume, expected=2)
    (marker,) = picked.markers
    assert "picked" in marker.flags
    nearest = np.abs(detected.centres_mm - marker.centre_mm).max(axis=1).min()
    assert nearest < 1e-3
    assert np.linalg.norm(marker.centre_mm - truth(volume)[0]) < 0.02


@pytest.mark.parametrize(
    ("shifts", "words"),
    [
        ([(0.0, 14.0, 0.0)], "pick 1 at .* (sphere|surface|radius)"),
        (
            [(500.0, 0.0, 0.0)],
            r"pick 1 at .* mm is outside the scanned volume; expected L -?\d+ to -?\d+, P .* mm\.",
        ),
        ([(0.0, 0.0, 0.0), (1.0, 0.0, 0.0)], "pick 2 at .* already found"),
        ([(float("nan"), 0.0, 0.0)], "three finite numbers"),
    ],
    ids=["beside the sphere", "outside", "twice", "not a number"],
)
def test_an_invalid_pick_is_refused_with_the_reason(
    volume: Volume, shifts: list[tuple[float, ...]], words: str
) -> None:
    with pytest.raises(errors.PickRefused, match=words) as caught:
        localize_picks(volume, truth(volume)[0] + np.array(shifts))
    assert caught.value.exit_code == 3


def test_a_pick_on_something_doubtful_is_taken_and_its_doubts_are_told() -> None:
    scan = Scan(shape=(40, 80, 80))
    middle = np.array([20.0, 20.0, 20.0])
    for step_mm in (-0.6, 0.0, 0.6):
        scan.ball(middle + np.array([0.0, 0.0, step_mm]))
    picked = localize_picks(as_volume(scan), middle[None])
    (marker,), (said,) = picked.markers, picked.doubtful
    assert said.accepted
    assert "longer in one direction than in another" in said.reason
    assert marker.odds == said.odds < 0.2


@pytest.mark.parametrize(("factors", "hint"), [((-1.0, -1.0, 1.0), "RAS"), ((1e-3, 1e-3, 1e-3), "metres")])
def test_picks_in_ras_or_in_metres_are_refused_with_a_hint(
    volume: Volume, factors: tuple[float, ...], hint: str
) -> None:
    with pytest.raises(errors.PickRefused, match=f"pick 1 at .* on a sphere in {hint}"):
        localize_picks(volume, truth(volume)[:1] * factors)


def test_an_array_instead_of_a_volume_is_refused_with_advice() -> None:
    with raises(
        errors.LOCALIZATION_MISUSED, match=r"CT-017: .* in mm: ndarray\. Read one with .*read_series"
    ):
        localize(np.zeros((4, 4, 4), dtype=np.int16))  # type: ignore[arg-type]


def test_fewer_picks_than_expected_are_refused(volume: Volume) -> None:
    with pytest.raises(errors.MarkerCountWrong, match="1 marker found, 2 expected"):
        localize_picks(volume, truth(volume)[:1], expected=2)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("plain.csv", "1,2,3\n-4,5.5,6\n"),
        ("named.csv", "name,S_mm,L_mm,P_mm\nM1,3,1,2\nM2,6,-4,5.5\n"),
        ("germany.csv", "# a, b\nL_mm;P_mm;S_mm\n1; 2; 3\n-4; 5.5; 6\n"),
        ("list.json", "[[1, 2, 3], [-4, 5.5, 6]]"),
        ("own.json", '{"spheres": [{"centre_mm": [1, 2, 3]}, {"centre_mm": [-4, 5.5, 6]}]}'),
        ("printed.json", '{"markers": [{"centre_mm": [1, 2, 3]}, {"centre_mm": [-4, 5.5, 6]}]}'),
        (
            "slicer.mrk.json",
            json.dumps(
                {
                    "markups": [
                        {
                            "coordinateSystem": "RAS",
                            "controlPoints": [{"position": [-1, -2, 3]}, {"position": [4, -5.5, 6]}],
                        }
                    ]
                }
            ),
        ),
    ],
)
def test_picks_are_read_from_common_file_formats(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    np.testing.assert_allclose(read_picks(str(tmp_path / name)), [[1.0, 2.0, 3.0], [-4.0, 5.5, 6.0]])


@pytest.mark.parametrize("text", ["x,y,z\n1,2,3\n", "# a\n1 2 3\n", "1,2,3\n4,5\n", "1,5;2,5;3,5\n"])
def test_a_line_that_is_not_a_pick_is_reported_with_the_expected_format(tmp_path: Path, text: str) -> None:
    (tmp_path / "picks.csv").write_text(text)
    line = 2 if text.startswith(("#", "1,2,3")) else 1
    with pytest.raises(errors.PicksUnreadable, match=f"picks.csv, line {line} .* header L_mm,P_mm,S_mm"):
        read_picks(tmp_path / "picks.csv")


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("words.csv", "left,right,middle\n"),
        ("two.csv", "1,2\n3,4\n"),
        ("ragged.csv", "1,2,3\n4,5\n"),
        ("nan.csv", "1,2,nan\n"),
        ("empty.csv", ""),
        ("cut.json", "[[1, 2"),
        ("other.json", '{"points": []}'),
        ("number.json", "7"),
        ("flat.json", '{"markups": [1]}'),
        ("named.json", '{"markups": {"a": 1}}'),
        ("none.json", '{"spheres": []}'),
        ("frame.json", '{"markups": [{"coordinateSystem": "ABC", "controlPoints": []}]}'),
    ],
)
def test_a_file_without_picks_is_refused(tmp_path: Path, name: str, text: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(errors.PicksUnreadable, match=name) as refused:
        read_picks(tmp_path / name)
    # no words of the program
    assert not re.search("object|attribute|subscript|iterable|sequence|argument", str(refused.value))
    with pytest.raises(errors.PicksUnreadable, match="No such file"):
        read_picks(tmp_path / "missing.csv")
