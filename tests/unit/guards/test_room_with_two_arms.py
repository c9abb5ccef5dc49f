"""Both arms are in one estimate of the room: at rest, and while the assistant leads an instrument."""

from __future__ import annotations

from typing import Any

import pytest
from scipy.spatial.transform import RigidTransform
from two_arm_room import OVER_GUIDE_RAD, STILL, TwoArmRoom, shifted, turned_about

from procedures.calibration.errors import PlatformMoved
from procedures.guards.assistant_on_axis import (
    LARGEST_OFF_MM,
    READINGS,
    AssistantOnAxis,
    BesideBore,
    beside_bore,
)
from procedures.guards.errors import BaseShifted, InsertionDisturbed, PatientMoved
from procedures.room.motion import Moved


@pytest.mark.hazard(61)
def test_a_cart_of_the_assistant_that_was_moved_is_named_in_any_pose() -> None:
    room = TwoArmRoom()
    assert room.look().in_place
    moved = room.look(assistant=shifted(0.0, 0.4, 0.0)).moved
    assert isinstance(moved, PlatformMoved)
    assert moved.way_mm == pytest.approx((0.0, 0.4, 0.0), abs=0.15)
    assert room.look(OVER_GUIDE_RAD).in_place
    assert isinstance(room.look(assistant=turned_about(room.frame_mm, 0.4)).moved, PlatformMoved)


@pytest.mark.hazard(61)
def test_the_assistant_does_not_hide_who_else_was_moved() -> None:
    room = TwoArmRoom()
    assert isinstance(room.look(master=shifted(0.0, 0.6, 0.0)).moved, BaseShifted)
    assert isinstance(room.look(head=shifted(0.0, 0.6, 0.0)).moved, PatientMoved)
    pushed = shifted(0.0, 4.0, 1.0)
    looked = room.look(assistant=pushed, master=pushed, head=pushed)
    assert looked.in_place
    assert "the tracker was moved" in looked.findings[0]


@pytest.mark.hazard(61)
def test_a_cart_that_moves_while_the_bases_are_measured_is_found_once_they_are_known() -> None:
    room = TwoArmRoom(known=False)
    room.turn_frame(shifted(0.0, 1.5, 0.0))
    motion = room.take_in()
    assert motion is not None
    assert motion.moved is Moved.ASSISTANT
    assert motion.moved_mm == pytest.approx(1.5, abs=0.3)
    before = len(room.watch.looks)
    room.turn_frame()  # measured again, with the carts locked
    assert room.take_in(before) is None


@pytest.mark.hazard(64)
def test_an_instrument_in_the_guide_is_left_there_when_the_assistant_was_displaced() -> None:
    room = TwoArmRoom()
    assert room.look(OVER_GUIDE_RAD, led=True).in_place
    moved = room.look(assistant=shifted(0.0, 0.6, 0.0), led=True).moved
    assert isinstance(moved, InsertionDisturbed)
    assert moved.action == InsertionDisturbed.by_hand


def beside(room: TwoArmRoom, *, counted: bool = False, **displaced: Any) -> BesideBore | None:
    """The instrument beside the bore by a reading, counted among the looks or not."""
    reading = room.reading(**displaced)
    judged = room.watch.compare(reading).judged if counted else room.watch.judge(reading)
    return beside_bore(room.workcell(), room.watch, judged)


@pytest.mark.hazard(64)
@pytest.mark.parametrize("counted", [False, True])
def test_what_the_looks_leave_open_counts_against_the_bore(counted: bool) -> None:
    room = TwoArmRoom()
    room.joints_rad = OVER_GUIDE_RAD
    found = beside(room, counted=counted)
    assert found is not None
    assert found.is_within
    assert 0.1 < found.uncertain_mm < LARGEST_OFF_MM
    assert beside(room, hidden=True) is None


@pytest.mark.hazard(64)
@pytest.mark.parametrize("counted", [False, True])
def test_a_cart_that_moved_on_the_way_is_beside_the_bore_by_the_whole_of_it(counted: bool) -> None:
    room = TwoArmRoom()
    room.joints_rad = OVER_GUIDE_RAD
    moved_mm = LARGEST_OFF_MM - 0.1
    found = beside(room, counted=counted, assistant=shifted(0.0, moved_mm, 0.0))
    assert found is not None
    assert found.seen_mm == pytest.approx(moved_mm, abs=0.1)
    assert not found.is_within


@pytest.mark.hazard(64)
def test_where_the_guides_arm_is_hidden_the_assistant_is_held_against_its_joints() -> None:
    room = TwoArmRoom()
    room.joints_rad = OVER_GUIDE_RAD
    still = beside(room, guide_hidden=True)
    assert still is not None
    assert still.is_within
    moved = beside(room, guide_hidden=True, assistant=shifted(0.0, LARGEST_OFF_MM - 0.1, 0.0))
    assert moved is not None
    assert not moved.is_within


@pytest.mark.hazard(64)
def test_a_repeated_look_over_the_guide_forgives_nothing() -> None:
    room = TwoArmRoom()
    room.joints_rad = OVER_GUIDE_RAD
    displaced = shifted(0.0, LARGEST_OFF_MM - 0.1, 0.0)
    for _ in range(3):
        found = beside(room, counted=True, assistant=displaced)
        assert found is not None
        assert not found.is_within


def test_an_assistant_that_no_look_has_shown_is_not_within_the_bore() -> None:
    unknown = TwoArmRoom(known=False)
    assert unknown.take_in() is None
    unknown.joints_rad = OVER_GUIDE_RAD
    first = beside(unknown)
    assert first is None or not first.is_within


class Led:
    """An assistant over the guide that begins to lead its instrument."""

    def __init__(self) -> None:
        self.room = TwoArmRoom()
        self.room.look(OVER_GUIDE_RAD, led=True)
        workcell = self.room.workcell()
        self.watch = AssistantOnAxis(workcell, workcell.assistant, self.room.watch)

    def see(self, cart: RigidTransform = STILL, *, hidden: bool = False) -> bool:
        """See a mean of frames; return whether the assistant was displaced."""
        for _ in range(READINGS):
            self.watch.add_frame(self.room.frame(cart, hidden=hidden))
        return self.watch.now is not None and self.watch.now.has_moved


@pytest.mark.hazard(64)
def test_a_cart_that_moves_across_the_axis_or_turns_is_noticed_on_the_way_and_nothing_else_is() -> None:
    across, turned, along, hidden = Led(), Led(), Led(), Led()
    assert not across.see()
    assert across.see(shifted(0.0, 1.2, 0.0))
    assert turned.see(turned_about(turned.room.frame_mm, 2.0))
    assert not along.see(shifted(0.0, 0.0, 3.0))
    assert not hidden.see(shifted(0.0, 2.0, 0.0), hidden=True)
