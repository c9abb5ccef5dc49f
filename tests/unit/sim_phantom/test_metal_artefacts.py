"""Metal casts shadows and streaks as the physics of a scan has it, and leaves other slices alone."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from sim.phantom.head.shapes import Ball, Rod
from sim.phantom.scanner.faults import KERNELS
from sim.phantom.scanner.grid import CtGrid
from sim.phantom.scanner.metal_artefacts import METALS, MetalArtefacts, MetalPart

Array = NDArray[np.float64]

GRID = CtGrid((-63.5, -63.5, 0.0), 1.0, 1.0, 128, 128, 24)
HEIGHT = 12
PAIR_X = (-9.0, 9.0)


def screws(metal: str, radius_mm: float = 1.6) -> tuple[MetalPart, ...]:
    """Two upright screws 18 mm apart, from slice 6 to 18."""
    return tuple(
        MetalPart(Rod(3500.0, (x, 0.0, 6.0), (0.0, 0.0, 1.0), 12.0, radius_mm), METALS[metal]) for x in PAIR_X
    )


def artefacts(parts: tuple[MetalPart, ...], number: int = HEIGHT, noise_HU: float = 5.0) -> Array:
    """Artefact, in HU, of one slice of a water disc."""
    x, y = GRID.x_mm, GRID.y_mm
    water = np.where(np.hypot(x, y[:, None]) < 50.0, 0.0, -1000.0).astype(np.float32)
    image = water.copy()
    scanner = MetalArtefacts(parts, ((0.0, 0.0, 12.0),), GRID, KERNELS["standard"], 1.0, noise_HU)
    scanner.add(image, number, np.random.default_rng(1))
    return np.asarray(image - water, dtype=np.float64)


def mean_hu(added: Array, x_mm: float, y_mm: float, half_mm: float = 2.5) -> float:
    across = np.abs(GRID.x_mm - x_mm) < half_mm
    down = np.abs(GRID.y_mm - y_mm) < half_mm
    return float(added[np.ix_(down, across)].mean())


def test_between_two_screws_it_is_darker_than_beside_them() -> None:
    added = artefacts(screws("titanium"))
    assert mean_hu(added, 0.0, 0.0) < -30.0
    assert mean_hu(added, 0.0, 0.0) < mean_hu(added, 0.0, 15.0) - 30.0


def test_steel_casts_a_deeper_shadow_than_titanium_and_a_thick_screw_than_a_thin_one() -> None:
    thin, thick, steel = (
        mean_hu(artefacts(one), 0.0, 0.0)
        for one in (screws("titanium", 1.2), screws("titanium", 2.0), screws("steel", 2.0))
    )
    assert steel < thick < thin < 0.0


def test_few_photons_behind_metal_make_streaks_along_the_line_through_it() -> None:
    quiet, noisy = (artefacts(screws("steel", 2.0), noise_HU=one) for one in (5.0, 60.0))
    streaks = noisy - quiet
    along = np.ix_(np.abs(GRID.y_mm) < 2.0, np.abs(GRID.x_mm) > 14.0)
    across = np.ix_(np.abs(GRID.y_mm) > 14.0, np.abs(GRID.x_mm) < 2.0)
    assert streaks[along].std() > 2.0 * streaks[across].std()


@pytest.mark.parametrize("number", [2, 22])
def test_a_slice_without_metal_keeps_every_digit(number: int) -> None:
    assert not artefacts(screws("steel"), number).any()


def test_a_filling_as_wide_as_the_screw_is_long_streaks_in_its_own_slices() -> None:
    filling = (MetalPart(Ball(8000.0, (0.0, 0.0, 12.0), 3.0), METALS["amalgam"]),)
    assert np.abs(artefacts(filling)).max() > 100.0
    assert not artefacts(filling, 17).any()
