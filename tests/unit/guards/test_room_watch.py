"""What a look at the room takes for a motion of head, cart or tracker: by the noise of its own frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray
from room_trials import TrackedCase

from procedures.guards.errors import BaseShifted, PatientMoved
from procedures.guards.room_reading import CAREFUL_FRAMES, FRAMES
from procedures.guards.room_watch import RoomLook, RoomWatch
from procedures.room.sighting import Rest, Sighting, Tracked
from procedures.strategies.strategy import ONE_SIDE
from ronna_hw.vectors import JointVector
from sim.world.rigid import matrix_from, rotation_from_vector

STILL = (0.0, 0.0, 0.0)
LookAt = Callable[..., RoomLook]


class Room:
    """A localized case, with the looks over the spheres of its first target."""

    def __init__(self) -> None:
        self.case = TrackedCase(4)
        self.watch, self.kept = self.case.begin(), list[Sighting]()
        self.watch.keep = self.kept.append
        self._motions = 0
        self.first = self.case.visits[0]
        for joints in (self.case.home_rad, *self.first.over_spheres, self.case.home_rad):
            assert self.look(joints).in_place

    def look(
        self,
        joints: JointVector | None = None,
        *,
        head_mm: ArrayLike = STILL,
        cart_mm: ArrayLike = STILL,
        cart_deg: ArrayLike = STILL,
        about_mm: ArrayLike | None = None,
        push_mm: ArrayLike = STILL,
        frames: int = CAREFUL_FRAMES,
        watch: RoomWatch | None = None,
    ) -> RoomLook:
        """Look with the arm settled there, by default home; a push moves head and cart alike."""
        watch = watch or self.watch
        joints = joints or self.case.home_rad
        self._motions += 1
        true = self.case.at_rest(joints, ONE_SIDE, self._motions)
        turn = rotation_from_vector(np.radians(cart_deg))
        about = np.zeros(3) if about_mm is None else np.asarray(about_mm, dtype=float)
        reading = self.case.read(
            watch,
            joints,
            true,
            frames,
            head=matrix_from(np.add(head_mm, push_mm), np.eye(3)),
            cart=matrix_from(np.add(cart_mm, push_mm) + about - turn @ about, turn),
            sides=ONE_SIDE,
        )
        return watch.compare(reading.moved_by(watch.tracker.move.inverse(), watch.robot_from_tracker))

    @property
    def frame_at_home_mm(self) -> NDArray[np.float64]:
        """Where the frame on the arm is with the arm home, robot frame."""
        flange = self.case.true_flange(self.case.home_rad)
        return np.asarray((flange @ self.case.flange_from_marker)[:3, 3])


@pytest.fixture
def room() -> Room:
    return Room()


@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
def test_a_look_of_many_frames_notices_what_one_of_few_does_not(room: Room) -> None:
    moved = (0.0, 0.07, 0.0)
    assert room.look(head_mm=moved, frames=FRAMES // 6).moved is None
    with pytest.raises(PatientMoved):
        room.look(head_mm=moved).require()


@pytest.mark.hazard(13)
def test_a_cart_that_turns_about_the_frame_on_the_arm_is_seen_by_the_lever_to_the_target(room: Room) -> None:
    turned = {"cart_deg": (0.0, 0.17, 0.0), "about_mm": room.frame_at_home_mm}
    looked = room.look(**turned)  # type: ignore[arg-type]
    if looked.moved is None:  # 0.3 mrad of noise at home: at the target there is a lever
        looked = room.look(room.first.at, **turned)  # type: ignore[arg-type]
    assert isinstance(looked.moved, BaseShifted)
    assert looked.moved.cart


@pytest.mark.hazard(13)
def test_a_local_error_of_the_arm_is_known_from_the_looks_at_the_spheres(room: Room) -> None:
    assert room.look(room.first.at).in_place
    base = room.watch.estimate.displacement(
        room.watch.points_mm[room.first.target], len(room.watch.estimate.looks) - 1, {"base": 1.0}
    )
    assert np.sqrt(np.trace(base.covariance_mm2)) < 0.3  # the arm is off by half a millimetre there
    unknown = room.case.begin()
    assert room.look(watch=unknown).in_place
    assert room.look(room.first.at, watch=unknown).in_place
    far = unknown.estimate.displacement(unknown.points_mm[room.first.target], 2, {"base": 1.0})
    assert np.trace(far.covariance_mm2) > 4.0 * np.trace(base.covariance_mm2)


@pytest.mark.hazard(13)
def test_a_drift_adds_up_over_looks_that_each_find_little(room: Room) -> None:
    found = [room.look(cart_mm=(0.0, 0.035 * number, 0.0)).moved for number in range(1, 9)]
    first = next(number for number, moved in enumerate(found) if moved is not None)
    assert isinstance(found[first], BaseShifted)
    assert first >= 1


@pytest.mark.hazard(13)
def test_a_moved_tracker_is_followed_where_head_and_arm_agree_on_it(room: Room) -> None:
    pushed = {"push_mm": (0.0, 4.0, 1.0)}
    looked = room.look(**pushed)  # type: ignore[arg-type]
    assert looked.in_place
    assert "the tracker was moved: by 4.1 mm" in looked.findings[0]
    assert room.look(**pushed).findings == ()  # type: ignore[arg-type]
    assert isinstance(room.look(head_mm=(0.5, 0.0, 0.0), **pushed).moved, PatientMoved)  # type: ignore[arg-type]


@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
def test_a_look_says_how_far_head_and_arm_are_even_when_something_has_moved(room: Room) -> None:
    moved = room.look(head_mm=(0.0, 0.0, 1.0))
    assert moved.head_mm == pytest.approx(1.0, abs=0.1)
    assert moved.base_mm == pytest.approx(0.0, abs=0.15)
    assert isinstance(moved.moved, PatientMoved)


def test_what_is_not_seen_is_not_compared(room: Room) -> None:
    reading = room.case.read(room.watch, room.case.home_rad, np.eye(4), CAREFUL_FRAMES, hidden=True)
    rests = {Tracked.ARM: Rest(room.case.home_rad)}
    blind = replace(reading, rests=rests, frame_mm=None, groups=(), markers_mm=np.empty((0, 3)), frames={})
    looked = room.watch.compare(blind)
    assert (looked.head_mm, looked.base_mm, looked.moved) == (None, None, None)
    assert not looked.in_place
    assert looked.findings == ()  # whoever needs to see it says so


@pytest.mark.hazard(13)
def test_a_resumed_case_judges_by_all_looks_before_its_restart(room: Room) -> None:
    turned = {"cart_deg": (0.0, 0.42, 0.0), "about_mm": room.frame_at_home_mm}
    again = room.case.begin()
    again.restore([Sighting.from_plain(look.as_plain()) for look in room.kept])
    now, then = again.estimate, room.watch.estimate
    assert now.information.shape == then.information.shape
    assert isinstance(room.look(watch=again, **turned).moved, BaseShifted)  # type: ignore[arg-type]


@pytest.mark.hazard(13)
def test_a_head_whose_moves_were_followed_one_after_the_other_is_expected_where_it_is(room: Room) -> None:
    localized_mm, to_tracker = room.watch.spheres_mm, room.watch.robot_from_tracker.rotation_matrix.T
    first, second = ((0.0, 1.0, 0.0), (0.0, 2.5, 0.0))
    room.watch.follow(localized_mm + to_tracker @ first)
    assert room.look(head_mm=first).in_place
    again = room.case.begin()  # the second move ends the watch
    again.keep = room.kept.append
    again.restore([Sighting.from_plain(look.as_plain()) for look in room.kept])
    again.follow(localized_mm + to_tracker @ second)
    assert again.epoch == 2
    assert room.look(head_mm=second, watch=again).in_place
    assert isinstance(room.look(head_mm=first, watch=again).moved, PatientMoved)
