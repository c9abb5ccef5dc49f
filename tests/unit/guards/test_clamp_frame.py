"""The patient's frame on the head clamp: it stands in for hidden spheres, is compared with visible ones."""

from __future__ import annotations

import math

import numpy as np
import pytest
from clamp_trials import ClampedCase, push
from numpy.typing import NDArray

from procedures.guards.errors import FrameSlipped, PatientMoved
from procedures.guards.head_frames import AVERAGED, HeadFrames, PatientFrames
from procedures.guards.room_reading import FRAMES, PATIENT_LIMIT_MM
from procedures.guards.stability import CAREFUL_FRAMES
from ronna_hw.devices.readings import Stamp, StrayReading, TrackerFrame, Validity
from ronna_hw.frames import Frame, Transform

SEEDS = range(20)
UP_MM = (0.0, 3.0, 0.0)
LOOKS = pytest.mark.parametrize("frames", [FRAMES, CAREFUL_FRAMES])
SIGHT = pytest.mark.parametrize("hidden", [False, True], ids=["spheres seen", "spheres hidden"])


@pytest.fixture
def generator() -> np.random.Generator:
    return np.random.default_rng(47)


@pytest.fixture
def case(generator: np.random.Generator) -> ClampedCase:
    return ClampedCase(0, generator)


def direction(generator: np.random.Generator) -> NDArray[np.float64]:
    way = generator.standard_normal(3)
    return np.asarray(way / np.linalg.norm(way))


@LOOKS
@SIGHT
def test_a_room_at_rest_is_in_place(frames: int, hidden: bool, generator: np.random.Generator) -> None:
    for seed in SEEDS:
        case = ClampedCase(seed, generator)
        look = case.watch.compare(case.read(frames, hidden=hidden), now_s=5.0)
        assert look.in_place
        assert case.watch.seen_s == 5.0


@pytest.mark.hazard(12)
@LOOKS
@SIGHT
def test_a_head_that_moves_with_its_clamp_is_never_taken_for_a_pushed_tracker(
    frames: int, hidden: bool, generator: np.random.Generator
) -> None:
    for seed in SEEDS:
        case = ClampedCase(seed, generator)
        moved = (0.5 + 0.2 * seed) * direction(generator)
        look = case.watch.compare(case.read(frames, hidden=hidden, head_mm=moved, clamp_mm=moved))
        assert isinstance(look.moved, PatientMoved)


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
        case = ClampedCase(seed, generator)
        look = case.watch.compare(case.read(frames, clamp_mm=0.5 * direction(generator)))
        with pytest.raises(
            FrameSlipped, match=r"PRO-051.*limit 0\.\d+ mm, got 0\.\d+ mm.*run global_localization"
        ):
            look.require()


@pytest.mark.hazard(12)
def test_a_head_that_slips_in_its_clamp_is_told_from_a_slipped_frame(case: ClampedCase) -> None:
    look = case.watch.compare(case.read(FRAMES, head_mm=(0.0, 0.0, 1.0)))
    with pytest.raises(PatientMoved, match="the head has moved in its clamp"):
        look.require()


@pytest.mark.hazard(13)
@LOOKS
def test_a_pushed_and_turned_tracker_is_followed(frames: int, generator: np.random.Generator) -> None:
    for seed in SEEDS:
        case = ClampedCase(seed, generator)
        turn = math.radians(0.5) * direction(generator)
        pushed = push(20.0 * direction(generator), turn, case.tracker_mm)
        look = case.watch.compare(case.read(frames, pushed=pushed))
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
    followed_mm, pose = np.add(case.watch.spheres_mm, UP_MM), case.watch.on_clamp
    assert pose is not None
    case.watch.compare(
        case.read(CAREFUL_FRAMES, pushed=push((10.0, 0.0, 0.0), (0, 0, 0.005), case.tracker_mm))
    )
    case.watch.follow(followed_mm, pose.pose.displace(UP_MM))
    assert case.watch.spheres_mm == pytest.approx(case.watch.tracker_move.apply(followed_mm))
    assert case.watch.on_clamp is not None
    assert case.watch.on_clamp.pose.translation_mm == pytest.approx(
        case.watch.tracker_move.apply(np.add(pose.pose.translation_mm, UP_MM))
    )


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


def test_the_pose_of_a_moved_frame_is_that_seen_by_the_moved_tracker(case: ClampedCase) -> None:
    assert case.watch.on_clamp is not None
    move = Transform.of(Frame.TRACKER, Frame.TRACKER, translation_mm=(1.0, 2.0, 3.0))
    moved = case.watch.on_clamp.moved_by(move)
    assert moved.places_mm - case.watch.on_clamp.places_mm == pytest.approx(np.tile((1.0, 2.0, 3.0), (4, 1)))
