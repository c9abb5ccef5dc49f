"""A simulated theatre's room in a person's hands: what is moved or hidden shows, and the truth says why."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator

import numpy as np
import pytest
from coded_errors import raises

from ronna_hw import SimulatedTheatre, StrayWarning, simulated_theatre, track_strays
from ronna_hw.arguments import WrongArgument
from ronna_hw.control_port import ControlRequestRefused
from ronna_hw.devices import JointMove, OpticalTracker, new_frames
from ronna_hw.devices.errors import DEVICE_STREAMS, THEATRE_CLOSED
from ronna_hw.devices.sensors import read_new_frame
from ronna_hw.room_truth import Origin
from ronna_hw.simulated_room import SimulatedRoom, UnseenSphereWarning
from ronna_hw.theatre import TheatreProcess

WITHIN_MM = 1.5  # of truth, for one reading of one sphere


@pytest.fixture(scope="module")
def theatre() -> Iterator[SimulatedTheatre]:
    with simulated_theatre("mini", seed=7) as theatre:
        yield theatre


@pytest.fixture
def tracker(theatre: SimulatedTheatre) -> Iterator[OpticalTracker]:
    with theatre.tracker.active() as tracker:
        yield tracker
    theatre.room.clear()


def strays_mm(tracker: OpticalTracker) -> list[tuple[float, float, float]]:
    return [stray.position_mm for stray in read_new_frame(tracker).strays]


def test_every_stray_is_a_sphere_of_the_truth(theatre: SimulatedTheatre, tracker: OpticalTracker) -> None:
    truth = theatre.room.truth()
    seen = strays_mm(tracker)
    assert len(seen) == sum(one.seen for one in truth.spheres) == 3
    for place in seen:
        nearest = truth.nearest(place)
        assert np.linalg.norm(np.subtract(nearest.tracker_mm, place)) < WITHIN_MM
        assert not truth.is_phantom(place)


def test_a_hidden_sphere_is_not_seen_and_the_room_says_why(
    theatre: SimulatedTheatre, tracker: OpticalTracker
) -> None:
    assert theatre.room.why("sphere 2") == "in view"
    theatre.room.hide("sphere 2")
    assert len(strays_mm(tracker)) == 2
    assert theatre.room.why("sphere 2") == "covered by a fault"
    theatre.room.clear()
    assert len(strays_mm(tracker)) == 3


def test_a_sphere_outside_the_measuring_volume_is_seen_all_the_same(
    theatre: SimulatedTheatre, tracker: OpticalTracker
) -> None:
    robot_from_tracker = theatre.room.truth().robot_from_tracker
    sideways = robot_from_tracker.apply((600.0, 0.0, 0.0)) - robot_from_tracker.apply((0.0, 0.0, 0.0))
    theatre.room.move("tracker", sideways.tolist())
    spheres = theatre.room.truth().spheres
    assert [one.in_volume for one in spheres] == [False] * len(spheres)
    assert all(one.seen and "outside" in one.because for one in spheres)
    read = strays_mm(tracker)
    for one in spheres:
        assert min(np.linalg.norm(np.subtract(one.tracker_mm, place)) for place in read) < WITHIN_MM


def test_a_head_that_is_moved_takes_its_spheres_along(
    theatre: SimulatedTheatre, tracker: OpticalTracker
) -> None:
    before = theatre.room.truth()
    theatre.room.move("head", (0.0, 20.0, 0.0))
    after = theatre.room.truth()
    moved_mm = [
        np.linalg.norm(np.subtract(a.tracker_mm, b.tracker_mm))
        for a, b in zip(before.spheres, after.spheres, strict=True)
    ]
    assert moved_mm == pytest.approx([20.0] * 3)
    assert all(
        np.linalg.norm(np.subtract(after.nearest(place).tracker_mm, place)) < WITHIN_MM
        for place in strays_mm(tracker)
    )


def test_points_where_lines_of_sight_cross_are_phantoms_in_truth(
    theatre: SimulatedTheatre, tracker: OpticalTracker
) -> None:
    theatre.room.inject("tracker phantoms 40 mm")
    truth = theatre.room.truth()
    assert len(truth.phantoms_mm)
    assert [place for place in strays_mm(tracker) if truth.is_phantom(place)]


def test_a_sphere_is_placed_where_the_tracker_reads_it_and_taken_away_again(
    theatre: SimulatedTheatre, tracker: OpticalTracker
) -> None:
    place_mm = (20.0, 100.0, -1800.0)
    line = theatre.room.place_sphere(place_mm)
    origins = {theatre.room.truth().origin_of(one).name: one for one in strays_mm(tracker)}
    assert np.linalg.norm(np.subtract(origins["extra sphere 1"], place_mm)) < WITHIN_MM
    theatre.room.move("tracker", (0.0, 0.0, 30.0))
    shifted = next(one for one in theatre.room.truth().others if one.name == "extra sphere 1")
    assert np.linalg.norm(np.subtract(shifted.tracker_mm, place_mm)) == pytest.approx(30.0)  # it rests
    theatre.room.clear(line)
    assert len(strays_mm(tracker)) == 3
    with raises(WrongArgument, match="tracker or robot"):
        theatre.room.place_sphere(place_mm, "ct")


def test_a_sphere_that_the_tracker_does_not_see_is_placed_with_a_word_why(
    theatre: SimulatedTheatre, tracker: OpticalTracker
) -> None:
    with pytest.warns(
        UnseenSphereWarning, match="extra sphere 1 at .* outside the unit's first measuring volume"
    ):
        theatre.room.place_sphere((-200.0, 0.0, -2600.0))
    assert theatre.room.why("extra sphere 1") == "in view, but outside the unit's first measuring volume"
    with pytest.warns(UnseenSphereWarning, match="outside the field of view"):
        theatre.room.place_sphere((0.02, 0.1, -1.8))  # in metres by mistake
    with raises(WrongArgument, match=r"extra sphere 1 is at that place"):
        theatre.room.place_sphere((-200.0, 0.0, -2600.0))


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda room: room.move("hed", (0.0, 1.0, 0.0)), "Did you mean head"),
        (lambda room: room.move("head", (0.0, 1.0)), r"coordinates of the displacement have shape \(2,\)"),
        (lambda room: room.turn("head", (0.0, 999.0, 0.0)), "limit 180 deg"),
        (lambda room: room.hide("sphere 9"), "sphere 1, sphere 2, sphere 3, robot_frame"),
        (lambda room: room.hide("sphere 2 for 3 s"), "a time goes into for_s"),
        (lambda room: room.hide("sphere 2", for_s=0), "for_s is no time"),
        (lambda room: room.hide("extra sphere 1"), r"clear\(\) with the line"),
        (lambda room: room.show("sphere 1"), "sphere 1 is not hidden"),
        (lambda room: room.place_sphere((20.0, 100.0, -9000.0)), "in the tracker's frame"),
        (lambda room: room.truth().origin_of((float("nan"), 0.0, 0.0)), "not finite"),
    ],
)
def test_a_wrong_argument_is_refused_in_the_words_of_the_call(
    theatre: SimulatedTheatre, call: Callable[[SimulatedRoom], object], says: str
) -> None:
    with raises(WrongArgument, match=says):
        call(theatre.room)


def test_the_truth_tells_reflections_from_spheres_and_phantoms(
    theatre: SimulatedTheatre, tracker: OpticalTracker
) -> None:
    theatre.room.inject("tracker reflections 4")
    truth = theatre.room.truth()
    assert len(truth.reflections_mm) == 4
    seen = [place for _ in range(10) for place in strays_mm(tracker)]
    kinds = [truth.origin_of(place).kind for place in seen]
    assert kinds.count(Origin.SPHERE) == 30
    assert 0 < kinds.count(Origin.REFLECTION) == len(kinds) - 30
    assert sum(map(truth.is_reflection, seen)) == kinds.count(Origin.REFLECTION)


def test_tracks_of_spheres_are_not_accused_and_phantoms_of_two_of_them_are(
    theatre: SimulatedTheatre, tracker: OpticalTracker
) -> None:
    assert len(track_strays(new_frames(tracker, 30))) == 3  # a warning would be an error here
    x_mm, y_mm, z_mm = theatre.room.truth().spheres[0].tracker_mm
    theatre.room.place_sphere((x_mm, y_mm + 60.0, z_mm))  # in one plane with it and both sensors
    with pytest.warns(StrayWarning) as warned:
        tracks = track_strays(new_frames(tracker, 30))
    truth = theatre.room.truth()
    named = set(map(int, re.findall(r"\d+", str(warned[0].message).partition(" cross")[0])))
    origins = {one.identity: truth.origin_of(one.positions_mm.mean(axis=0)) for one in tracks}
    phantoms = {identity for identity, one in origins.items() if one.kind is Origin.PHANTOM}
    assert phantoms
    assert phantoms <= named
    assert {origins[identity].name for identity in named - phantoms} <= {"sphere 1", "extra sphere 1"}


def test_an_unknown_sphere_is_named_beside_those_there_are(theatre: SimulatedTheatre) -> None:
    with raises(WrongArgument, match="sphere 1, sphere 2, sphere 3"):
        theatre.room.why("sphere 9")


def test_the_theatre_of_a_run_does_not_tell_the_truth(tmp_path_factory: pytest.TempPathFactory) -> None:
    process = TheatreProcess("--scene", "mini", "--out", str(tmp_path_factory.mktemp("theatre")))
    try:
        process.await_ready()
        with SimulatedTheatre.of(process) as theatre, raises(ControlRequestRefused, match="tell the truth"):
            theatre.room.truth()
    finally:
        process.end()


def test_a_tracker_is_not_read_beside_its_stream(tracker: OpticalTracker) -> None:
    frames = iter(tracker.stream())
    next(frames)
    with raises(DEVICE_STREAMS, match="tracker: read_frame"):
        tracker.read_frame()
    frames.close()
    assert tracker.read_frame().stamp.sequence > 0


def test_devices_refuse_a_wrong_argument_in_the_words_of_the_call(theatre: SimulatedTheatre) -> None:
    arm, cameras = theatre.arms["master"], theatre.stereo
    with arm.active():
        joints_rad = arm.read_state().joints_rad
        with raises(WrongArgument, match=r"JointMove\(target_rad\)"):
            arm.move(joints_rad)
        moved = arm.move(JointMove(np.array(joints_rad)))
        assert moved.joints_rad == pytest.approx(joints_rad, abs=1e-4)
    with raises(WrongArgument, match="no joint vector"):
        JointMove(np.eye(3))
    with cameras.active():
        with raises(WrongArgument, match="the exposure in us is no number"):
            cameras.set_exposure("fast", 0)
        with raises(WrongArgument, match="timeout_s is no time"):
            cameras.grab_pair(timeout_s=0)
        pairs = iter(cameras.stream())
        next(pairs)
        with raises(DEVICE_STREAMS, match="configure"):
            cameras.configure()
        pairs.close()


def test_theatre_devices_and_truth_are_shown_in_one_line(
    theatre: SimulatedTheatre, tracker: OpticalTracker
) -> None:
    assert repr(tracker) == "<PolarisTracker tracker: active>"
    assert "robot.master configured, tracker active" in repr(theatre)
    assert repr(theatre.arms) == "<arms: master>"
    theatre.room.hide("sphere 2")
    truth = theatre.room.truth()
    assert "3 spheres, 2 seen; not sphere 2 (covered by a fault)" in repr(truth)
    assert "<td>sphere 2</td><td>sphere</td>" in truth._repr_html_()
    assert "token" not in repr(theatre.room)


def test_whatever_is_kept_of_a_closed_theatre_says_that_it_is_closed() -> None:
    with simulated_theatre("mini", seed=7) as theatre:
        room, tracker, arm, cameras = theatre.room, theatre.tracker, theatre.arms["master"], theatre.stereo
    for call in (
        room.truth,
        tracker.connect,
        arm.read_state,
        arm.stop,
        cameras.grab_pair,
        tracker.read_frame,
    ):
        with raises(THEATRE_CLOSED):
            call()
