"""The studies have one budget for the places of spheres, that of whole cases."""

from __future__ import annotations

import math

import pytest

from procedures.planning.target_error import USUAL_SEATING_MM
from sim.world.scene.model import SEATING_ERROR_MM
from studies.accuracy.scene import CT_FLE_MM, FINE_CT_MM
from studies.sphere_errors import AS_IN_A_CASE, SET_S_RMS_MM, SphereErrors


def test_localization_and_seating_add_as_variances_on_each_of_three_axes() -> None:
    errors = SphereErrors(localization_mm=0.3, seating_mm=0.4)
    assert errors.per_axis_mm == pytest.approx(0.5)
    assert errors.rms_mm == pytest.approx(0.5 * math.sqrt(3.0), abs=5e-4)


def test_a_study_seats_spheres_as_the_default_scene_and_the_planner_do() -> None:
    assert AS_IN_A_CASE.seating_mm == SEATING_ERROR_MM == USUAL_SEATING_MM
    assert AS_IN_A_CASE.rms_mm == FINE_CT_MM
    assert CT_FLE_MM == SET_S_RMS_MM
