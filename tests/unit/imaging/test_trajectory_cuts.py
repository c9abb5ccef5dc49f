"""Three cuts through a target, with the patient's sides where radiologists expect them."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from procedures.imaging.trajectory_cuts import GAP_PX, HALF_WIDTH_MM, STEP_MM, trajectory_cuts
from procedures.imaging.volume import Volume, VoxelGeometry

SIZE = 2 * round(HALF_WIDTH_MM / STEP_MM) + 1
MIDDLE = SIZE // 2
BRIGHT_HU, AIR_HU = 3000, -1000
OFF_MM = 40.0


def volume(mark_mm: tuple[float, float, float]) -> Volume:
    """Air, 2 mm to a voxel, slices upwards, with one bright block at a place (L, P, S)."""
    geometry = VoxelGeometry(
        (100, 100, 100),
        np.array([-99.0, -99.0, -99.0]),
        np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
        np.array([2.0, 2.0, 2.0]),
    )
    voxels = np.full(geometry.shape, AIR_HU, np.int16)
    s, p, left = np.rint(geometry.to_index(mark_mm)).astype(int)
    voxels[s - 3 : s + 4, p - 3 : p + 4, left - 3 : left + 4] = BRIGHT_HU
    return Volume(voxels, geometry, "1.2", "1.3")


def planes(
    mark_mm: tuple[float, float, float], target_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> list[np.ndarray]:
    """The three planes through a target of a head whose middle is the origin."""
    target = np.array(target_mm)
    ways = {"T1": (target + np.array([0.0, 0.0, 30.0]), target)}
    drawn = trajectory_cuts(volume(mark_mm), ways, "T1", np.zeros(3))
    whole = cv2.imdecode(np.frombuffer(drawn, np.uint8), 1)
    return [whole[:, k * (SIZE + GAP_PX) :][:, :SIZE] for k in range(3)]


@pytest.mark.parametrize(
    ("mark_mm", "plane", "right", "down"),
    [
        ((OFF_MM, 0.0, 0.0), 0, +1, 0),  # the patient's left is on the right
        ((0.0, OFF_MM, 0.0), 0, 0, +1),  # the back below
        ((OFF_MM, 0.0, 0.0), 1, +1, 0),
        ((0.0, 0.0, OFF_MM), 1, 0, -1),  # the crown above
        ((0.0, OFF_MM, 0.0), 2, +1, 0),  # the back on the right
        ((0.0, 0.0, OFF_MM), 2, 0, -1),
    ],
)
def test_a_mark_appears_on_its_own_side_of_the_target(
    mark_mm: tuple[float, float, float], plane: int, right: int, down: int
) -> None:
    off = round(OFF_MM / STEP_MM)
    x, y = MIDDLE + right * off, MIDDLE + down * off
    picture = planes(mark_mm)[plane]
    assert picture[y, x].tolist() == [255, 255, 255]
    assert picture[MIDDLE - down * off, MIDDLE - right * off].max() == 0


def test_a_trajectory_is_drawn_in_its_plane_and_at_the_target() -> None:
    axial, coronal, _ = planes((OFF_MM, OFF_MM, OFF_MM))
    up = MIDDLE - round(25.0 / STEP_MM)
    assert coronal[up, MIDDLE].max() > 200  # the way runs upwards in this plane
    near_target = axial[MIDDLE - 2 : MIDDLE + 3, MIDDLE - 2 : MIDDLE + 3]
    assert near_target.max() > 200


def test_the_far_side_of_the_head_is_in_the_picture_of_a_target_at_its_edge() -> None:
    nose_mm, occiput_mm = -70.0, 80.0  # 150 mm apart: more than half of a plane
    _, _, sagittal = planes((0.0, occiput_mm, 0.0), target_mm=(0.0, nose_mm, 0.0))
    across = [MIDDLE + round(posterior_mm / STEP_MM) for posterior_mm in (nose_mm, occiput_mm)]
    target, mark = sagittal[MIDDLE, across]
    assert target.max() > 200
    assert mark.tolist() == [255, 255, 255]
