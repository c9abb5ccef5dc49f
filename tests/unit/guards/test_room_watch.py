"""From which displacement on a look takes head, cart or tracker for moved: less at home than on the way."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from clinical_case import SPHERES_MM
from numpy.typing import ArrayLike

from procedures.guards.base_shift import BASE_LIMIT_MM
from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.guards.room_reading import FRAMES, RoomReading
from procedures.guards.room_watch import RoomWatch
from procedures.guards.stability import BASE_NOTICEABLE_MM, CAREFUL_FRAMES, HEAD_NOTICEABLE_MM
from ronna_hw.frames import Frame, Transform

HOME = Transform.of(Frame.ROBOT, Frame.FLANGE, translation_mm=(500.0, 0.0, 600.0))


def reading(
    frame_mm: ArrayLike = (0.0, 0.0, 0.0),
    head_mm: ArrayLike = (0.0, 0.0, 0.0),
    *,
    frames: int = CAREFUL_FRAMES,
    settled: bool = True,
) -> RoomReading:
    """A reading at home, with the frame on the arm and the head so far from where they were localized."""
    spheres_mm = np.add(SPHERES_MM, head_mm)
    place_mm = np.asarray(frame_mm, dtype=float)
    return RoomReading(HOME, place_mm, spheres_mm, frames=frames, settled=settled, arm_frame_mm=place_mm)


@pytest.fixture
def watch() -> RoomWatch:
    """Since a careful localization, and a careful look with every joint settled home."""
    localized = reading(settled=False)  # nobody knows from which side the joints had come
    return RoomWatch("1", Transform.of(Frame.ROBOT, Frame.TRACKER), SPHERES_MM.copy(), [localized, reading()])


@pytest.mark.hazard(12)
def test_a_careful_look_notices_half_the_head_movement_of_a_short_one(watch: RoomWatch) -> None:
    moved = (0.0, 1.2 * HEAD_NOTICEABLE_MM, 0.0)
    assert watch.compare(reading(head_mm=moved, frames=FRAMES)).require() == ()
    with pytest.raises(PatientMoved, match=r"limit 0\.15 mm, got 0\.18 mm"):
        watch.compare(reading(head_mm=moved)).require()


@pytest.mark.hazard(13)
def test_a_careful_look_at_home_notices_a_fifth_of_the_cart_movement_of_a_short_one(watch: RoomWatch) -> None:
    moved = (1.2 * BASE_NOTICEABLE_MM, 0.0, 0.0)
    assert BASE_NOTICEABLE_MM < BASE_LIMIT_MM / 5
    assert watch.compare(reading(moved, frames=FRAMES)).require() == ()
    with pytest.raises(
        BaseShifted,
        match=r"the cart of the robot was moved, the frame on the arm by 0\.18 mm.*limit 0\.15 mm",
    ):
        watch.compare(reading(moved)).require()


@pytest.mark.hazard(13)
def test_a_careful_look_is_compared_as_a_short_one_with_what_was_read_shortly(watch: RoomWatch) -> None:
    watch.references[:] = [reading(frames=FRAMES)]
    looked = watch.compare(reading((0.6, 0.0, 0.0)))
    assert looked.moved is None
    assert looked.base is not None
    assert looked.base.limit_mm == BASE_LIMIT_MM


@pytest.mark.hazard(13)
def test_only_joints_that_came_home_from_the_same_side_show_a_small_movement(watch: RoomWatch) -> None:
    watch.references[1:] = [reading((0.1, 0.0, 0.0))]  # backlash, since it was jogged home before
    moved = (0.1 + 1.2 * BASE_NOTICEABLE_MM, 0.0, 0.0)
    assert watch.compare(reading(moved, settled=False)).require() == ()
    with pytest.raises(BaseShifted, match=r"by 0\.18 mm.*limit 0\.15 mm, got 0\.18 mm"):
        watch.compare(reading(moved)).require()


@pytest.mark.hazard(13)
def test_a_cart_that_turned_about_the_frame_on_the_arm_has_moved(watch: RoomWatch) -> None:
    def turned(deg: float, *, settled: bool = True) -> RoomReading:
        half_rad = np.radians(deg) / 2.0
        about_z = (np.cos(half_rad), 0.0, 0.0, np.sin(half_rad))
        by_frame = Transform.of(Frame.ROBOT, Frame.TRACKER, quaternion_wxyz=about_z)
        return replace(reading(settled=settled), robot_from_tracker=by_frame)

    assert watch.compare(turned(0.0)).require() == ()
    assert watch.compare(turned(0.1)).require() == ()  # noise
    assert watch.compare(turned(0.3, settled=False)).require() == ()  # backlash turns the frame as well
    with pytest.raises(BaseShifted, match=r"turned by 0\.30 deg.*limit 0\.23 deg"):
        watch.compare(turned(0.3)).require()


@pytest.mark.hazard(13)
def test_a_drift_adds_up_over_looks_that_each_find_little(watch: RoomWatch) -> None:
    step_mm = 0.6 * BASE_NOTICEABLE_MM
    for number in (0, 1):
        assert watch.compare(reading((number * step_mm, 0.0, 0.0))).require() == ()
    with pytest.raises(BaseShifted):
        watch.compare(reading((2 * step_mm, 0.0, 0.0))).require()


@pytest.mark.hazard(13)
def test_a_tracker_moved_by_little_is_a_finding_and_voids_nothing(watch: RoomWatch) -> None:
    way = (0.0, 3.6 * BASE_NOTICEABLE_MM, 0.0)
    looked = watch.compare(reading(way, way))
    assert looked.moved is None
    (finding,) = looked.findings
    assert finding.startswith("the tracker was moved by 0.54 mm")
    assert "arm and head agree" in finding


@pytest.mark.hazard(13)
def test_a_head_followed_before_the_tracker_crept_stays_in_place(watch: RoomWatch) -> None:
    up, crept = np.array([0.0, 0.0, 2.0]), np.array([0.0, 3.6 * BASE_NOTICEABLE_MM, 0.0])
    for _ in range(2):
        watch.follow(SPHERES_MM + up)  # as every step that looks at the room
        assert watch.compare(reading(head_mm=up)).findings == ()
    for count in (1, 0, 0):
        watch.follow(SPHERES_MM + up)
        seen = reading(crept, up + crept).moved_by(watch.tracker.move.inverse(), watch.robot_from_tracker)
        looked = watch.compare(seen)
        assert looked.in_place
        assert len(looked.findings) == count


@pytest.mark.hazard(13)
def test_a_tracker_moved_by_more_than_the_limit_at_any_rest_has_moved(watch: RoomWatch) -> None:
    way = (0.0, 1.1 * BASE_LIMIT_MM, 0.0)
    looked = watch.compare(reading(way, way))
    assert isinstance(looked.moved, BaseShifted)
    assert not looked.moved.cart


@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
def test_a_comparison_says_how_far_head_and_cart_are_even_when_something_has_moved(watch: RoomWatch) -> None:
    quiet = watch.compare(reading((0.05, 0.0, 0.0), (0.0, 0.0, 0.02)))
    assert quiet.base is not None
    assert (quiet.head_mm, quiet.base.moved_mm) == (pytest.approx(0.02), pytest.approx(0.05))
    assert quiet.moved is None
    moved = watch.compare(reading(head_mm=(0.0, 0.0, 1.0)))
    assert moved.head_mm == pytest.approx(1.0)
    assert isinstance(moved.moved, PatientMoved)


def test_what_is_not_seen_is_not_compared(watch: RoomWatch) -> None:
    blind = RoomReading(HOME, None, SPHERES_MM[:2], frames=CAREFUL_FRAMES)
    looked = watch.compare(blind)
    assert (looked.head_mm, looked.base, looked.moved) == (None, None, None)
    assert not looked.in_place
    assert looked.findings == ()  # whoever needs to see it says so
