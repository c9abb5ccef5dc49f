"""Clearance of both arms after a cart has moved: what one look tells holds for both."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import pytest

from procedures.workcell.assistant import ONE_LOOK_MM, TURNED_CART, TURNED_SHARE, Assistant
from procedures.workcell.master import Master
from ronna_hw.arm.clearance.bodies import Capsule, Obstacle, Surroundings
from ronna_hw.arm.pose import Pose
from ronna_hw.frames import Frame, Transform
from ronna_hw.roles import ASSISTANT

HEAD = Obstacle("head", Capsule((500.0, 0.0, 0.0), (500.0, 0.0, 0.0), 90.0), True)
ON_CART = Obstacle("cabinet", Capsule((0.0, 0.0, -300.0), (0.0, 0.0, -400.0), 200.0))
AROUND = Surroundings(obstacles=(HEAD, ON_CART))
BASE = Transform.of(Frame.ROBOT, Frame.ASSISTANT, translation_mm=(-1300.0, 0.0, 0.0))
MOVED = Transform.of(Frame.ROBOT, Frame.ROBOT, translation_mm=(0.0, 40.0, 0.0))


class StandIn:
    """Arm that records what it declares: of the master, its surroundings; of the assistant, its base."""

    def __init__(self) -> None:
        self.surroundings, self.base = AROUND, BASE
        self.history = SimpleNamespace(base_uncertain_mm=1.0)
        self.among_arms: list[tuple[str, Pose, float]] = []
        self._arms = SimpleNamespace(
            placed=SimpleNamespace(is_placed=lambda _role: True),
            place=lambda *placed: self.among_arms.append(placed),
        )
        self.recorded: list[tuple[Transform, float]] = []
        self.placed: list[tuple[Transform, float]] = []

    def _declare(self, around: Surroundings) -> None:
        self.surroundings = around

    def record_base(self, base: Transform, uncertain_mm: float) -> None:
        self.recorded.append((base, uncertain_mm))

    def place_base(self, base: Transform, uncertain_mm: float) -> None:
        self.placed.append((base, uncertain_mm))

    def _surround_again(self) -> None:
        pass


@pytest.mark.hazard(58)
def test_a_moved_cart_of_the_master_moves_head_and_assistant_against_it() -> None:
    master, assistant = StandIn(), StandIn()
    Master.shift_room(cast("Any", master), MOVED, [ON_CART.name])
    Assistant.shift_room(cast("Any", assistant), MOVED, [ON_CART.name])
    head, cabinet = master.surroundings.obstacles
    assert head.capsule.start_mm == pytest.approx((500.0, 40.0, 0.0))
    assert cabinet == ON_CART
    ((role, base, uncertain_mm),) = assistant.among_arms
    assert role == ASSISTANT
    assert base.position_mm == pytest.approx((-1300.0, 40.0, 0.0))
    assert uncertain_mm == 1.0 + ONE_LOOK_MM


@pytest.mark.hazard(58)
def test_a_later_program_knows_how_far_the_assistant_may_be_from_where_it_has_it() -> None:
    """It has the head where it was as well: both fit together."""
    assistant = StandIn()
    Assistant.shift_room(cast("Any", assistant), MOVED, [])
    assert assistant.recorded == [(BASE, 1.0 + 40.0)]


@pytest.mark.hazard(58)
def test_an_assistant_that_was_seen_elsewhere_is_kept_farther_away() -> None:
    assistant = StandIn()
    Assistant.doubt(cast("Any", assistant), 3.0)
    assert assistant.placed == [(BASE, 1.0 + TURNED_CART * 3.0)]


@pytest.mark.hazard(58)
def test_an_assistant_is_taken_for_where_its_frame_was_seen_on_the_way_home() -> None:
    assistant = StandIn()
    Assistant.follow(cast("Any", assistant), (0.0, 20.0, 0.0))
    ((base, uncertain_mm),) = assistant.placed
    assert base.translation_mm == pytest.approx((-1300.0, 20.0, 0.0))
    assert uncertain_mm == 1.0 + ONE_LOOK_MM + TURNED_SHARE * 20.0
