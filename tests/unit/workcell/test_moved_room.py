"""Clearance of both arms after a cart has moved: what one look tells holds for both."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from procedures.workcell import Workcell
from procedures.workcell.workcell import ONE_LOOK_MM, TURNED_CART, TURNED_SHARE
from ronna_hw.arm.clearance.bodies import Capsule, Obstacle, Surroundings
from ronna_hw.arm.pose import Pose
from ronna_hw.frames import Frame, Transform

HEAD = Obstacle("head", Capsule((500.0, 0.0, 0.0), (500.0, 0.0, 0.0), 90.0), True)
ON_CART = Obstacle("cabinet", Capsule((0.0, 0.0, -300.0), (0.0, 0.0, -400.0), 200.0))
AROUND = Surroundings(obstacles=(HEAD, ON_CART))
BASE = Transform.of(Frame.ROBOT, Frame.ASSISTANT, translation_mm=(-1300.0, 0.0, 0.0))
MOVED = Transform.of(Frame.ROBOT, Frame.ROBOT, translation_mm=(0.0, 40.0, 0.0))


class Cell:
    """Workcell with two arms that records what it declares of the assistant."""

    def __init__(self) -> None:
        self.surroundings = AROUND
        self._around_assistant = None
        self.of_pair: list[tuple[Pose, float]] = []
        self._pair = SimpleNamespace(place_assistant=lambda *placed: self.of_pair.append(placed))
        self.placed: list[tuple[Transform, float]] = []

    def _surround_master(self, around: Surroundings) -> None:
        self.surroundings = around

    def place_assistant(self, base: Transform, uncertain_mm: float) -> None:
        self.placed.append((base, uncertain_mm))

    def _require_assistant(self) -> Any:
        return SimpleNamespace(
            base=BASE,
            history=SimpleNamespace(base_uncertain_mm=1.0),
            place_base=lambda *placed: self.placed.append(placed),
        )


@pytest.mark.hazard(58)
def test_a_moved_cart_of_the_master_moves_head_and_assistant_against_it() -> None:
    cell = Cell()
    Workcell.shift_room(cast("Any", cell), MOVED, [ON_CART.name])
    head, cabinet = cell.surroundings.obstacles
    assert head.capsule.start_mm == pytest.approx((500.0, 40.0, 0.0))
    assert cabinet == ON_CART
    ((base, uncertain_mm),) = cell.of_pair
    assert base.position_mm == pytest.approx((-1300.0, 40.0, 0.0))
    assert uncertain_mm == 1.0 + ONE_LOOK_MM


@pytest.mark.hazard(58)
def test_a_later_program_knows_how_far_the_assistant_may_be_from_where_it_has_it() -> None:
    """It has the head where it was as well: both fit together."""
    cell = Cell()
    Workcell.shift_room(cast("Any", cell), MOVED, [])
    assert cell.placed == [(BASE, 1.0 + 40.0)]


@pytest.mark.hazard(58)
def test_an_assistant_that_was_seen_elsewhere_is_kept_farther_away() -> None:
    cell = Cell()
    Workcell.doubt_assistant(cast("Any", cell), 3.0)
    assert cell.placed == [(BASE, 1.0 + TURNED_CART * 3.0)]


@pytest.mark.hazard(58)
def test_an_assistant_is_taken_for_where_its_frame_was_seen_on_the_way_home() -> None:
    cell = Cell()
    Workcell.follow_assistant(cast("Any", cell), (0.0, 20.0, 0.0))
    ((base, uncertain_mm),) = cell.placed
    assert base.translation_mm == pytest.approx((-1300.0, 20.0, 0.0))
    assert uncertain_mm == 1.0 + ONE_LOOK_MM + TURNED_SHARE * 20.0
