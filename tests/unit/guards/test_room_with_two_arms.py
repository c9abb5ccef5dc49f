"""Both arms are in one estimate of the room: at rest, and while the assistant leads an instrument."""

from __future__ import annotations

import pytest
from scipy.spatial.transform import RigidTransform
from two_arm_room import OVER_GUIDE_RAD, STILL, TwoArmRoom, shifted, turned_about

from procedures.calibration.errors import PlatformMoved
from procedures.guards.assistant_on_axis import LARGEST_OFF_MM, READINGS, AssistantOnAxis, beside_bore
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


@pytest.mark.hazard(64)
def test_what_the_looks_leave_open_counts_against_the_bore() -> None:
    room = TwoArmRoom()
    room.look(OVER_GUIDE_RAD)
    workcell = room.workcell()
    found = beside_bore(workcell, room.watch, room.reading())
    assert found is not None
    assert found.is_within
    assert 0.05 < found.uncertain_mm < LARGEST_OFF_MM
    off = beside_bore(workcell, room.watch, room.reading(assistant=shifted(0.0, 0.45, 0.0)))
    assert off is not None
    assert off.seen_mm < LARGEST_OFF_MM < off.largest_mm
    assert beside_bore(workcell, room.watch, room.reading(hidden=True)) is None
    unknown = TwoArmRoom(known=False)
    assert unknown.take_in() is None
    first = beside_bore(unknown.workcell(), unknown.watch, unknown.reading(OVER_GUIDE_RAD))
    assert first is None or not first.is_within


class Led:
    """An assistant over the guide that begins to lead its instrument."""

    def __init__(self) -> None:
        self.room = TwoArmRoom()
        self.room.look(OVER_GUIDE_RAD, led=True)
        self.watch = AssistantOnAxis(self.room.workcell(), self.room.watch)

    def see(self, cart: RigidTransform = STILL, *, hidden: bool = False) -> bool:
        """See a mean of frames; return whether the assistant was displaced."""
        for _ in range(READINGS):
            self.watch.add_frame(self.room.frame(cart, hidden=hidden))
        return self.watch.now is not None and self.watch.now.has_moved


@pytest.mark.hazard(64)
def test_a_cart_that_moves_across_the_axis_is_noticed_on_the_way() -> None:
    led = Led()
    assert not led.see()
    assert led.see(shifted(0.0, 1.2, 0.0))


@pytest.mark.hazard(64)
def test_a_cart_that_turns_about_its_frame_is_noticed_where_the_clamp_is() -> None:
    led = Led()
    assert led.see(turned_about(led.room.frame_mm, 2.0))


def test_a_way_along_the_axis_and_hidden_frames_stop_nothing() -> None:
    led = Led()
    assert not led.see(shifted(0.0, 0.0, 3.0))
    assert not Led().see(shifted(0.0, 2.0, 0.0), hidden=True)
