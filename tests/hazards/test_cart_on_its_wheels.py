"""Hazard 49: despite tracker noise a locked cart never counts as rolling, nor a rolling one as locked."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest
from coded_errors import raises
from room_trials import STILL, TrackedCase

from procedures.guards.room_reading import RoomReading
from procedures.guards.room_watch import RoomWatch
from procedures.steps.clinical.cart_lock import LOCKED_LIMIT_MM, displacement_against_head
from procedures.steps.errors import CART_NOT_LOCKED

SCENES, TRIALS_PER_SCENE = 5, 20
ROLLED_MM = 1.0
pytestmark = pytest.mark.hazard(49)


def looks() -> Iterator[tuple[TrackedCase, RoomWatch, RoomReading]]:
    """The first look of 100 cases, of 12 frames: fewer than the step takes."""
    for seed in range(SCENES):
        case = TrackedCase(seed)
        for _ in range(TRIALS_PER_SCENE):
            watch = case.begin()
            yield case, watch, case.reading(watch, case.home_rad)


def test_a_cart_at_rest_is_never_refused() -> None:
    moved_mm = []
    for case, watch, first in looks():
        second = case.reading(watch, case.home_rad)
        way_mm, _ = displacement_against_head(watch.robot_from_tracker, first, second)
        moved_mm.append(float(np.linalg.norm(way_mm)))
    assert max(moved_mm) < 0.8 * LOCKED_LIMIT_MM


def test_a_cart_that_rolls_by_a_millimetre_is_always_detected() -> None:
    for case, watch, first in looks():
        second = case.reading(watch, case.home_rad, STILL, ROLLED_MM * case.direction())
        with raises(CART_NOT_LOCKED, match="PRO-041"):
            displacement_against_head(watch.robot_from_tracker, first, second)
