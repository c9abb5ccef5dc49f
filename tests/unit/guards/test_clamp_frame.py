"""The patient's frame on the head clamp: it stands in for hidden spheres, is compared with visible ones."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from clamp_trials import ClampedCase, clamped_case, push
from numpy.typing import NDArray

from procedures.guards.errors import BaseShifted, FrameSlipped, PatientMoved, RoomUndecided
from procedures.guards.head_frames import AVERAGED, PATIENT_LIMIT_MM, HeadFrames, PatientFrames
from procedures.guards.room_motion import name_motion
from procedures.guards.room_reading import CAREFUL_FRAMES, FRAMES
from procedures.room.motion import Moved, RoomMotion
from procedures.room.sighting import Tracked
from ronna_hw.devices.readings import Stamp, StrayReading, TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform
from sim.world.rigid import matrix_from

SEEDS = range(20)
UP_MM = (0.0, 3.0, 0.0)
LOOKS = pytest.mark.parametrize("frames", [FRAMES, CAREFUL_FRAMES])
SIGHT = pytest.mark.parametrize("hidden", [False, True], ids=["spheres seen", "spheres hidden"])


@pytest.fixture
def generator() -> np.random.Generator:
    return np.random.default_rng(47)


@pytest.fixture
def case() -> ClampedCase:
    return clamped_case(0)


def direction(generator: np.random.Generator) -> NDArray[np.float64]:
    way = generator.standard_normal(3)
    return np.asarray(way / np.linalg.norm(way))


@LOOKS
@SIGHT
def test_a_room_at_rest_is_in_place(frames: int, hidden: bool) -> None:
    for seed in SEEDS:
        case = clamped_case(seed)
        look = case.watch.compare(case.read(frames, hidden=hidden), now_s=5.0)
        assert look.in_place
        assert case.watch.head_sight.seen_s == 5.0


@LOOKS
def test_a_hidden_marker_of_the_frame_is_no_moved_head(frames: int) -> None:
    untold = 0
    for seed in SEEDS:
        case = clamped_case(seed)
        reading = case.read(frames, hidden=True)
        for marker in range(4):
            told, not_told = (
                case.watch.judge(replace(reading, frames={**reading.frames, Tracked.CLAMP: seen}))
                for seen in (case.see_clamp_without(marker, frames, is_told=told) for told in (True, False))
            )
            assert told.motion is None
            untold += not_told.motion is not None
    assert untold > 0  # what the tracker says of its markers is what tells them apart


@pytest.mark.hazard(12)
@LOOKS
@SIGHT
def test_a_head_that_moves_with_its_clamp_is_never_taken_for_a_pushed_tracker(
    frames: int, hidden: bool, generator: np.random.Generator
) -> None:
    for seed in SEEDS:
        case = clamped_case(seed)
        moved = (0.5 + 0.2 * seed) * direction(generator)
        look = case.watch.compare(case.read(frames, hidden=hidden, head_mm=moved, clamp_mm=moved))
        assert isinstance(look.moved, PatientMoved)
        assert_beyond_limit(look.moved)


def assert_beyond_limit(moved: PatientMoved) -> None:
    """Assert that the figures of a message do not look like a false alarm."""
    got, limit = ((words or "").partition(" mm")[0] for words in (moved.got, moved.limit))
    assert float(got) > float(limit) > 0.0


@pytest.mark.hazard(12)
def test_a_move_seen_by_the_frame_alone_says_so(case: ClampedCase) -> None:
    moved = (0.0, 2.0, 0.0)
    reading = case.read(CAREFUL_FRAMES, hidden=True, head_mm=moved, clamp_mm=moved)
    with pytest.raises(PatientMoved, match=r"PRO-020: the head clamp has moved.*frame on it.*hidden; limit"):
        case.watch.compare(reading).require()


@pytest.mark.hazard(12)
@LOOKS
def test_a_frame_that_slips_on_the_clamp_stops_the_case(frames: int, generator: np.random.Generator) -> None:
    for seed in SEEDS:
        case = clamped_case(seed)
        look = case.watch.compare(case.read(frames, clamp_mm=0.5 * direction(generator)))
        with pytest.raises(FrameSlipped):
            look.require()


@pytest.mark.hazard(12)
def test_a_head_that_slips_in_its_clamp_is_told_from_a_slipped_frame(case: ClampedCase) -> None:
    look = case.watch.compare(case.read(FRAMES, head_mm=(0.0, 0.0, 1.0)))
    with pytest.raises(PatientMoved, match="the head has moved in its clamp"):
        look.require()
    assert isinstance(look.moved, PatientMoved)
    assert_beyond_limit(look.moved)


@pytest.mark.hazard(12)
@pytest.mark.parametrize("rms_mm", [0.02, 0.095, 5.0])
def test_a_head_that_slips_in_its_clamp_is_shown_by_its_way_and_not_by_the_frame(rms_mm: float) -> None:
    """With few spheres the points of the frame are all that the head is seen by, and they have not moved."""
    motion = RoomMotion(Moved.HEAD_IN_CLAMP, 0, 100.0, 1.0, np.array([0.0, 0.0, 0.99]))
    case = clamped_case(0)
    expected = case.watch.expected(case.watch.judge(case.read(FRAMES, hidden=True)))
    reading = case.read(FRAMES, hidden=True)
    assert expected.clamp_mm is not None
    off_mm = expected.clamp_mm + np.array([rms_mm, 0.0, 0.0])
    expected = replace(expected, clamp_mm=off_mm, spheres_mm=np.empty((0, 3)))
    moved = name_motion(motion, expected, reading)
    assert isinstance(moved, PatientMoved)
    assert (moved.got, moved.limit) == ("0.99 mm", "0.10 mm")
    assert "spheres" not in moved.advice
    assert "run global_localization" not in moved.advice


@pytest.mark.parametrize(("moved_mm", "limit_mm"), [(0.0785, 0.0775), (0.301, 0.3), (0.0951, 0.0949)])
def test_a_displacement_just_beyond_its_limit_is_shown_beyond_it(moved_mm: float, limit_mm: float) -> None:
    assert_beyond_limit(PatientMoved.from_shift("the head has moved", moved_mm, limit_mm))


@pytest.mark.hazard(13)
def test_a_pushed_and_turned_tracker_is_followed(generator: np.random.Generator) -> None:
    for seed in SEEDS:
        case = clamped_case(seed)
        turn = math.radians(0.5) * direction(generator)
        pushed = push(20.0 * direction(generator), turn, case.tracker_mm)
        look = case.watch.compare(case.read(CAREFUL_FRAMES, pushed=pushed))
        assert look.in_place
        assert "the tracker was moved" in look.findings[0]
        assert case.watch.compare(case.read(CAREFUL_FRAMES, pushed=pushed)).moved is None
        moved = case.read(
            CAREFUL_FRAMES, hidden=True, head_mm=(1.0, 0.0, 0.0), clamp_mm=(1.0, 0.0, 0.0), pushed=pushed
        )
        assert isinstance(case.watch.compare(moved).moved, PatientMoved)


@pytest.mark.hazard(13)
def test_places_followed_before_a_push_are_expected_where_the_pushed_tracker_sees_them(
    case: ClampedCase,
) -> None:
    followed_mm, clamp = np.add(case.watch.spheres_mm, UP_MM), case.watch.epochs[0].clamp
    assert clamp is not None
    pose = Transform.from_matrix(Frame.TRACKER, Frame.PATIENT, clamp)
    pushed = push((10.0, 0.0, 0.0), (0, 0, 0.005), case.tracker_mm)
    case.watch.compare(case.read(CAREFUL_FRAMES, pushed=pushed))
    case.watch.follow(followed_mm, pose.displace(UP_MM))
    up_mm = case.watch.robot_from_tracker.rotation_matrix @ UP_MM
    looked = case.read(CAREFUL_FRAMES, pushed=pushed, head_mm=up_mm, clamp_mm=up_mm)
    assert case.watch.compare(looked).in_place
    assert isinstance(case.watch.compare(case.read(CAREFUL_FRAMES, pushed=pushed)).moved, PatientMoved)


@pytest.mark.hazard(12)
@SIGHT
def test_a_head_that_moved_during_a_push_seldom_passes_for_it(
    hidden: bool, generator: np.random.Generator
) -> None:
    followed = 0
    for seed in SEEDS:
        case = clamped_case(seed)
        pushed, moved = push(15.0 * direction(generator), (0, 0, 0), case.tracker_mm), direction(generator)
        reading = case.read(
            CAREFUL_FRAMES, hidden=hidden, head_mm=1.5 * moved, clamp_mm=1.5 * moved, pushed=pushed
        )
        followed += case.watch.compare(reading).moved is None
    assert followed <= (len(SEEDS) // 5 if hidden else 0)


@pytest.mark.hazard(12)
def test_a_push_adds_what_the_head_may_have_moved_meanwhile(
    case: ClampedCase, generator: np.random.Generator
) -> None:
    case.watch.compare(case.read(CAREFUL_FRAMES))
    _, quiet_mm = case.watch.changes_at("T1")["head"]
    pushed = push(15.0 * direction(generator), (0, 0, 0), case.tracker_mm)
    assert case.watch.compare(case.read(CAREFUL_FRAMES, pushed=pushed)).in_place
    _, pushed_mm = case.watch.changes_at("T1")["head"]
    assert pushed_mm > 1.5 * quiet_mm


@pytest.mark.hazard(13)
def test_a_short_look_follows_no_push(case: ClampedCase) -> None:
    pushed = push((0.0, 15.0, 0.0), (0, 0, 0), case.tracker_mm)
    look = case.watch.compare(case.read(FRAMES, pushed=pushed))
    assert isinstance(look.moved, BaseShifted)
    assert not look.moved.cart


@pytest.mark.hazard(12)
@pytest.mark.hazard(13)
@SIGHT
@pytest.mark.parametrize("moves", ["tracker", "head"])
def test_without_sight_of_the_arm_a_push_and_a_moved_head_are_undecided_and_told_apart_at_home(
    case: ClampedCase, hidden: bool, moves: str
) -> None:
    way_mm = np.array((0.0, 8.0, 0.0))
    pushed = push(way_mm, (0, 0, 0), case.tracker_mm) if moves == "tracker" else None
    head_mm = way_mm if moves == "head" else np.zeros(3)
    read = partial(case.read, CAREFUL_FRAMES, hidden=hidden, head_mm=head_mm, clamp_mm=head_mm, pushed=pushed)
    without_arm = {name: seen for name, seen in read().frames.items() if name is not Tracked.ARM}
    under_way = case.watch.compare(replace(read(), frames=without_arm, frame_mm=None))
    assert isinstance(under_way.moved, RoomUndecided)
    at_home = case.watch.compare(read())
    assert at_home.moved is None if moves == "tracker" else isinstance(at_home.moved, PatientMoved)


@pytest.mark.hazard(13)
def test_a_cart_that_moves_with_a_push_is_named_and_the_head_found_from_it(case: ClampedCase) -> None:
    way_mm, before = np.array((0.0, 30.0, 0.0)), case.watch.robot_from_tracker
    pushed = push((15.0, 0.0, 0.0), (0, 0, 0), case.tracker_mm)
    reading = case.read(CAREFUL_FRAMES, pushed=pushed, cart=matrix_from(way_mm, np.eye(3)))
    moved = case.watch.compare(reading).moved
    assert isinstance(moved, BaseShifted)
    assert moved.cart
    assert moved.room_moved is not None
    at_head_mm = before.apply(case.watch.spheres_mm)
    assert moved.room_moved.apply(at_head_mm) == pytest.approx(at_head_mm - way_mm, abs=0.5)


@pytest.mark.hazard(12)
def test_a_head_followed_while_its_frame_was_hidden_is_watched_by_the_spheres_alone(
    case: ClampedCase,
) -> None:
    up_mm = case.watch.robot_from_tracker.rotation_matrix @ UP_MM
    case.watch.follow(np.add(case.watch.spheres_mm, UP_MM), None)
    assert case.watch.compare(case.read(CAREFUL_FRAMES, head_mm=up_mm, clamp_mm=up_mm)).in_place
    case.watch.follow(None)
    assert case.watch.clamp_mm is not None
    assert case.watch.compare(case.read(CAREFUL_FRAMES)).in_place


def test_hidden_spheres_are_reported_once(case: ClampedCase) -> None:
    told = [
        case.watch.compare(case.read(FRAMES, hidden=hidden)).findings for hidden in (True, True, False, True)
    ]
    assert [len(findings) for findings in told] == [1, 0, 0, 1]
    assert "the frame on its clamp is watched" in told[0][0]


SPHERES_MM = np.array([[0.0, 0.0, -2000.0], [60.0, 0.0, -2000.0], [0.0, 50.0, -2000.0]])
ON_CLAMP_MM = np.add(SPHERES_MM, (200.0, 0.0, 0.0))
HALF_MM = (0.0, 0.5, 0.0)


def frame_with(places_mm: NDArray[np.float64]) -> TrackerFrame:
    strays = tuple(StrayReading((x, y, z), Validity.OK) for x, y, z in places_mm.tolist())
    return TrackerFrame(Stamp(0, 0, 0.0), Validity.OK, (), strays)


@pytest.mark.hazard(12)
def test_frame_by_frame_either_spheres_or_clamp_show_a_move() -> None:
    for spheres_mm, on_clamp_mm, moved_mm, seen in (
        (SPHERES_MM, ON_CLAMP_MM, 0.0, True),
        (SPHERES_MM[:0], np.add(ON_CLAMP_MM, HALF_MM), 0.5, True),
        (np.add(SPHERES_MM, HALF_MM), ON_CLAMP_MM, 0.5, True),
        (np.add(SPHERES_MM, HALF_MM), ON_CLAMP_MM[:0], 0.5, True),
        (SPHERES_MM[:0], ON_CLAMP_MM[:0], None, False),
    ):
        both = PatientFrames(HeadFrames(SPHERES_MM), HeadFrames(ON_CLAMP_MM))
        for _ in range(AVERAGED):
            both.add(frame_with(spheres_mm), on_clamp_mm.tolist())
        assert both.moved_mm == (None if moved_mm is None else pytest.approx(moved_mm, abs=1e-9))
        assert both.seen is seen
        assert ((both.moved_mm or 0.0) > PATIENT_LIMIT_MM) is (moved_mm == 0.5)


def test_without_a_frame_on_the_clamp_nothing_stands_in_for_the_spheres() -> None:
    alone = PatientFrames(HeadFrames(SPHERES_MM))
    alone.add(frame_with(SPHERES_MM[:0]), ())
    assert not alone.seen
