"""The skull along a trajectory: faces found in coarse and fine CT, and what is no skull."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from procedures.imaging.volume import Volume, VoxelGeometry
from procedures.planning.errors import MetalInSkull
from procedures.planning.skull_section import measure_skull
from procedures.strategies.trajectory import Trajectory

AXES = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]])
# Beginning (mm) and HU of the layers from the air inwards: skin, fat and muscle, two tables about a diploe.
HEAD = ((0.0, 40.0), (5.7, 1450.0), (7.5, 650.0), (10.7, 1450.0), (12.5, 30.0))
SATURATED_HU = 3071.0  # of 12 bits
INTO_HEAD = Trajectory("T1", (20.0, 20.0, 10.0), (20.0, 20.0, 60.0))


def volume(layers: tuple[tuple[float, float], ...], slice_mm: float, blur_mm: float = 0.6) -> Volume:
    """Return layers across the slices, whose skin is at 10 mm."""
    fine_mm = 0.05
    depths = np.arange(0.0, 80.0, fine_mm) - 10.0
    hu: NDArray[np.float64] = np.full(len(depths), -1000.0)
    for begin_mm, value in layers:
        hu[depths >= begin_mm] = value
    seen = ndimage.gaussian_filter1d(hu, blur_mm / fine_mm)
    centres_mm = np.arange(0.0, 75.0, slice_mm)
    seen = np.minimum(seen, SATURATED_HU)
    voxels = np.repeat(np.interp(centres_mm, depths + 10.0, seen), 400).reshape(-1, 20, 20)
    spacing = np.array([slice_mm, 2.0, 2.0])
    geometry = VoxelGeometry(voxels.shape, np.zeros(3), AXES, spacing)
    return Volume(voxels.astype(np.int16), geometry, "1.2.3", "1.2.4")


@pytest.mark.parametrize(("slice_mm", "within_mm"), [(0.5, 0.25), (1.0, 0.5), (1.5, 0.8)])
def test_both_faces_of_the_skull_are_found(slice_mm: float, within_mm: float) -> None:
    found = measure_skull(volume(HEAD, slice_mm), INTO_HEAD)
    assert found is not None
    assert found.outside_mm == pytest.approx(5.7, abs=within_mm)
    assert found.inside_mm == pytest.approx(12.5, abs=within_mm)


def test_an_air_cell_in_the_bone_is_no_inside() -> None:
    cell = (*HEAD[:2], (7.5, -900.0), (9.5, 650.0), *HEAD[3:])
    found = measure_skull(volume(cell, 0.5), INTO_HEAD)
    assert found is not None
    assert found.inside_mm == pytest.approx(12.5, abs=0.3)
    assert "an air cell" in found.doubt


@pytest.mark.hazard(65)
@pytest.mark.parametrize("slice_mm", [0.5, 1.0, 1.5])
@pytest.mark.parametrize(
    "plate_mm", [(12.5, 14.0), (4.0, 5.7), (8.0, 9.5)], ids=["inside", "outside", "diploe"]
)
def test_metal_in_the_skull_or_against_it_leaves_its_inside_unknown(
    plate_mm: tuple[float, float], slice_mm: float
) -> None:
    begin_mm, end_mm = plate_mm
    after_hu = [hu for at_mm, hu in HEAD if at_mm <= end_mm][-1]
    layers = [one for one in HEAD if not begin_mm <= one[0] <= end_mm]
    plated = tuple(sorted([*layers, (begin_mm, 8000.0), (end_mm, after_hu)]))
    with pytest.raises(MetalInSkull, match=r"PLAN-035.*where the skull ends there is not known"):
        measure_skull(volume(plated, slice_mm), INTO_HEAD)


@pytest.mark.hazard(65)
def test_dense_bone_is_no_metal_nor_is_a_clip_far_behind_the_skull() -> None:
    dense = tuple((at_mm, 2000.0 if hu == 1450.0 else hu) for at_mm, hu in HEAD)
    clip = ((28.0, 8000.0), (29.0, 30.0))
    found = measure_skull(volume((*dense, *clip), 0.5), INTO_HEAD)
    assert found is not None
    assert found.inside_mm == pytest.approx(12.5, abs=0.3)


@pytest.mark.hazard(65)
def test_a_calcified_dura_is_told_and_not_joined_to_the_skull() -> None:
    found = measure_skull(volume((*HEAD, (14.0, 1000.0), (17.0, 30.0)), 0.5), INTO_HEAD)
    assert found is not None
    assert found.inside_mm == pytest.approx(12.5, abs=0.4)
    assert "bone goes on behind a gap" in found.doubt
    assert found.further_mm == pytest.approx(17.0, abs=0.4)


BEHIND_SKULL = {
    "contrast of 350 HU": ((12.5, 350.0), (16.0, 30.0)),
    "contrast of 500 HU": ((12.5, 500.0), (16.0, 30.0)),
    "calcified dura, 0.8 mm behind": ((12.5, 60.0), (13.3, 900.0), (14.3, 30.0)),
}


@pytest.mark.hazard(65)
@pytest.mark.parametrize("behind", BEHIND_SKULL.values(), ids=BEHIND_SKULL.keys())
@pytest.mark.parametrize("slice_mm", [0.5, 1.0, 1.5])
def test_contrast_or_calcified_dura_against_the_inner_table_is_told_and_the_nearer_inside_counts(
    behind: tuple[tuple[float, float], ...], slice_mm: float
) -> None:
    found = measure_skull(volume((*HEAD[:-1], *behind), slice_mm), INTO_HEAD)
    assert found is not None
    assert found.inside_mm == pytest.approx(12.5, abs=0.7)
    assert "does not end sharply" in found.doubt
    assert found.further_mm is not None
    assert found.further_mm == pytest.approx(behind[-1][0], abs=1.0)


@pytest.mark.hazard(65)
@pytest.mark.parametrize("marrow_hu", [150.0, -50.0])
@pytest.mark.parametrize("slice_mm", [1.0, 1.5])
def test_a_diploe_of_marrow_has_two_readings_and_the_nearer_inside_counts(
    marrow_hu: float, slice_mm: float
) -> None:
    found = measure_skull(volume((*HEAD[:2], (7.5, marrow_hu), *HEAD[3:]), slice_mm), INTO_HEAD)
    assert found is not None
    assert found.inside_mm == pytest.approx(7.5, abs=0.4)
    assert found.furthest_mm == pytest.approx(12.5, abs=0.6)
    assert "diploe of marrow" in found.doubt


@pytest.mark.parametrize("inner_hu", [1450.0, 1000.0])
@pytest.mark.parametrize("slice_mm", [0.5, 1.0, 1.5])
def test_a_plain_skull_has_one_reading(inner_hu: float, slice_mm: float) -> None:
    found = measure_skull(volume((*HEAD[:3], (10.7, inner_hu), HEAD[-1]), slice_mm), INTO_HEAD)
    assert found is not None
    assert (found.doubt, found.further_mm) == ("", None)


@pytest.mark.parametrize(("clip", "is_found"), [((-4.0, -3.0), True), ((-1.0, 0.5), False)])
def test_a_clip_outside_the_skin_is_no_skull(clip: tuple[float, float], is_found: bool) -> None:
    begin_mm, end_mm = clip
    around = ((begin_mm, 3000.0), (end_mm, -1000.0 if end_mm < 0.0 else 40.0), *HEAD[end_mm > 0.0 :])
    found = measure_skull(volume(around, 0.5), INTO_HEAD)
    assert (found is not None) is is_found
    assert found is None or found.outside_mm == pytest.approx(5.7, abs=0.25)


@pytest.mark.parametrize("layers", [HEAD[:1], (*HEAD[:1], (5.7, 1450.0))], ids=["no bone", "no inside"])
def test_what_has_no_inside_is_left_to_a_hand(layers: tuple[tuple[float, float], ...]) -> None:
    assert measure_skull(volume(layers, 0.5), INTO_HEAD) is None
