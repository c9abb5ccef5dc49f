"""Ambiguous layouts of fiducials are detected in planning."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.planning.plan_check import layout_warnings, least_side_difference_mm


def triangle(first_mm: float, second_mm: float, third_mm: float) -> np.ndarray:
    """Three points with these distances."""
    along = (first_mm**2 + second_mm**2 - third_mm**2) / (2.0 * second_mm)
    return np.array([[0.0, 0, 0], [second_mm, 0, 0], [along, np.sqrt(first_mm**2 - along**2), 0]])


@pytest.mark.parametrize("sides_mm", [(90.0, 120.0, 84.1), (90.0, 120.0, 95.9), (90.0, 92.0, 140.0)])
def test_sides_that_differ_by_less_than_six_millimetres_are_warned_about(sides_mm):
    points = triangle(*sides_mm)
    smallest = np.diff(np.sort(sides_mm)).min()
    assert least_side_difference_mm(points) == pytest.approx(smallest)
    assert f"differ by {smallest:.1f} mm" in layout_warnings(points)[0]


@pytest.mark.parametrize("sides_mm", [(90.0, 120.0, 83.9), (90.0, 120.0, 96.1), (60.0, 100.0, 140.0)])
def test_sides_that_differ_by_six_millimetres_or_more_give_no_warning(sides_mm):
    assert layout_warnings(triangle(*sides_mm)) == []


def test_the_warning_about_a_rectangle_names_interchangeable_fiducials():
    rectangle = np.array([[0.0, 0, 0], [80, 0, 0], [80, 110, 0], [0, 110, 0]])
    (warning,) = layout_warnings(rectangle)
    assert "1 for 2" in warning or "1 for 3" in warning or "1 for 4" in warning


def test_one_sphere_out_of_the_plane_and_off_centre_removes_the_ambiguity():
    assert layout_warnings(np.array([[0.0, 0, 0], [80, 0, 0], [80, 110, 0], [0, 110, 0], [30, 20, 60]])) == []


@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_fiducials_give_no_layout_warning(count):
    assert layout_warnings(np.eye(3)[:count] * 50.0) == []
