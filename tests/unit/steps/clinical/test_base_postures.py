"""Postures in which two arms are measured against each other: near those of the work, on short ways."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.steps.clinical.two_arms.base_postures import (
    FLANGE_ONWARDS,
    face_along,
    order_by_travel,
    turn_towards,
)

STILL = (0.0,) * 5


def test_each_posture_is_the_one_nearest_to_the_previous_one() -> None:
    postures = [(turn_rad, *STILL) for turn_rad in (0.9, -0.3, 0.2, 2.0)]
    assert [first for first, *_ in order_by_travel((0.0, *STILL), postures)] == [0.2, -0.3, 0.9, 2.0]


def test_the_flange_is_turned_only_as_far_as_the_instrument_needs() -> None:
    inwards = np.array((0.1, 0.2, -1.0))
    held = face_along((1.0, 0.0, 0.0), inwards)
    assert held.apply((1.0, 0.0, 0.0)) == pytest.approx(inwards / np.linalg.norm(inwards))
    between_rad = np.arctan2(np.hypot(0.1, 0.2), 1.0)
    assert (FLANGE_ONWARDS.inv() * held).magnitude() == pytest.approx(between_rad)


@pytest.mark.parametrize("wanted", [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0), (0.3, -0.4, -2.0)])
def test_a_direction_is_turned_onto_any_other_also_onto_its_opposite(wanted: tuple[float, ...]) -> None:
    turned = turn_towards((0.0, 0.0, 2.0), wanted, np.pi).apply((0.0, 0.0, 1.0))
    assert turned == pytest.approx(np.array(wanted) / np.linalg.norm(wanted))
