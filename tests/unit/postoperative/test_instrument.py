"""The streaks of a rod are read along its shaft, and continued into the slices that its tip fills in part."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from procedures.postoperative.instrument import RodAxis, Slices, read_streaks

TIP = RodAxis(np.array([0.3, -0.2, 0.0]), np.array([0.4, 0.1, 1.0]), 0.0)
RAYS_HU, RAYS, SLICE_MM = 250.0, 5, 1.5


@pytest.fixture
def slices() -> Slices:
    """Voxels of 1 x 1 x 1.5 mm around that line."""
    grid = np.stack(
        np.meshgrid(np.arange(-5.0, 22.0), np.arange(-5.0, 9.0), np.arange(-3.0, 40.0, SLICE_MM)), axis=-1
    ).reshape(-1, 3)
    across = grid[:, :2] - TIP.point_mm[:2] - np.outer(grid[:, 2], TIP.outwards[:2])
    near = np.linalg.norm(across, axis=1) < 3.5
    return Slices(grid[near], np.array([0.0, 0.0, 1.0]), np.eye(3)[:, :2], SLICE_MM)


def rays(slices: Slices, line: RodAxis) -> NDArray[np.float64]:
    """Of a rod through all slices, in each about where it crosses the middle."""
    heights = slices.voxels[:, 2]
    across = slices.voxels[:, :2] - line.point_mm[:2] - np.outer(heights, line.outwards[:2])
    return RAYS_HU * np.sin(RAYS * np.arctan2(across[:, 1], across[:, 0]) + 0.7)


def test_the_pattern_of_the_shaft_continues_in_the_slices_of_the_tip(slices: Slices) -> None:
    true_hu = rays(slices, TIP)
    noisy = true_hu + np.random.default_rng(3).normal(0.0, 20.0, len(true_hu))
    usable = np.ones(len(true_hu), dtype=bool)
    found = read_streaks(slices, TIP, noisy, usable)
    shaft = found.shaft_hu != 0.0
    assert np.std((found.shaft_hu - true_hu)[shaft]) < 10.0
    (part,) = found.parts  # from 0.75 mm before the tip to 0.75 mm beyond it
    assert np.std((found.hu(np.array([1.0, 0.0])) - true_hu)[part]) < 15.0
    assert np.all(found.low < found.start)
    assert np.all(found.start < found.high)


def test_a_rod_that_lies_in_the_slices_has_no_streaks_to_read(slices: Slices) -> None:
    flat = RodAxis(TIP.point_mm, np.array([1.0, 0.2, 0.1]), 0.0)
    found = read_streaks(slices, flat, rays(slices, TIP), np.ones(len(slices.voxels), dtype=bool))
    assert found.parts == ()
    assert not found.hu(found.start).any()


def test_from_a_few_voxels_no_streaks_are_read(slices: Slices) -> None:
    usable = np.zeros(len(slices.voxels), dtype=bool)
    usable[-50:] = True
    assert read_streaks(slices, TIP, rays(slices, TIP), usable).parts == ()
