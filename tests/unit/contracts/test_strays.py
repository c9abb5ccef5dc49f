"""Unidentified stray markers are grouped over the frames and averaged, or followed from frame to frame."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises
from hypothesis import given, settings
from hypothesis import strategies as st

from ronna_hw.arguments import WrongArgument
from ronna_hw.devices.errors import BAD_STRAYS
from ronna_hw.devices.readings import Stamp, StrayReading, ToolReading, TrackerFrame, Validity
from ronna_hw.devices.stray_tracks import UNKNOWN, StrayWarning, identify_strays, track_strays
from ronna_hw.devices.strays import GATE_MM, average_strays, group_strays

NOISE_MM = np.array([0.04, 0.04, 0.14])


@pytest.fixture
def random():
    return np.random.default_rng(11)


@pytest.fixture
def spheres():
    return np.array([[0.0, 0, -1500], [60, 10, -1480], [-40, 55, -1520], [20, -70, -1490], [-75, -20, -1510]])


def noisy_frames(spheres, random, count=60):
    """Each frame in another order."""
    return [random.permutation(spheres + random.normal(size=spheres.shape) * NOISE_MM) for _ in range(count)]


def test_each_sphere_becomes_one_group_with_a_better_mean(spheres, random):
    groups = group_strays(noisy_frames(spheres, random)).groups
    assert len(groups) == 5
    for group in groups:
        assert group.count == 60
        assert np.linalg.norm(spheres - group.mean_mm, axis=1).min() < 4 * NOISE_MM.max() / np.sqrt(60)
        assert group.spread_mm == pytest.approx(np.linalg.norm(NOISE_MM), rel=0.3)
        assert np.sqrt(np.diag(group.covariance_mm2)) == pytest.approx(NOISE_MM, rel=0.4)


@pytest.mark.hazard(14)
def test_a_flickering_reflection_is_rejected_and_an_occluded_sphere_kept(spheres, random):
    frames = noisy_frames(spheres, random)
    frames = [np.vstack([f, [[500.0, 0.0, 0.0]]]) if k % 3 == 0 else f for k, f in enumerate(frames)]
    frames = [
        f[np.linalg.norm(f - spheres[0], axis=1) > 5.0] if 20 <= k < 45 else f for k, f in enumerate(frames)
    ]
    average = group_strays(frames)
    assert sorted(group.count for group in average.groups) == [35, 60, 60, 60, 60]
    assert [group.count for group in average.rejected] == [20]


def test_two_touching_spheres_stay_separate(random):
    pair = np.array([[0.0, 0.0, 0.0], [11.5, 0.0, 0.0]])
    assert [group.count for group in group_strays(noisy_frames(pair, random)).groups] == [60, 60]


def test_a_single_outlier_does_not_shift_the_mean_but_shows_in_the_spread(random):
    sphere = np.zeros((1, 3))
    frames = noisy_frames(sphere, random)
    frames[30] = np.array([[3.0, 0.0, 0.0]])
    (group,) = group_strays(frames).groups
    assert group.outliers == 1
    assert np.linalg.norm(group.mean_mm) < 0.1
    assert group.spread_mm > 0.3


def test_identical_readings_have_zero_spread():
    (group,) = group_strays([[(1.0, 2.0, 3.0)]] * 10).groups
    assert group.mean_mm.tolist() == [1.0, 2.0, 3.0]
    assert group.spread_mm == 0.0
    assert group.outliers == 0


def test_no_strays_give_no_groups():
    assert group_strays([]).groups == ()
    assert group_strays([np.zeros((0, 3))] * 5).groups == ()


def test_only_strays_inside_the_volume_and_new_measurements_are_averaged():
    def frame(number, *strays, validity=Validity.OK):
        return TrackerFrame(Stamp(number, number, number / 60), validity, (), strays)

    inside = StrayReading((0.0, 0.0, -1500.0), Validity.OK)
    outside = StrayReading((0.0, 0.0, -3500.0), Validity.OUT_OF_VOLUME)
    frames = [frame(k, inside, outside) for k in range(10)]
    average = average_strays([*frames, frame(9, inside, outside, validity=Validity.STALE)])
    assert average.frames == 10
    assert [group.count for group in average.groups] == [10]
    assert average.groups[0].mean_mm.tolist() == [0.0, 0.0, -1500.0]


@pytest.mark.parametrize(
    ("frames", "wish"),
    [
        ([[(np.nan, 0.0, 0.0)]], {}),
        ([[(1.0, 2.0)]], {}),
        ([[1.0, 2.0, 3.0]], {}),
        ([], {"radius_mm": 0.0}),
        ([], {"least_share": 1.5}),
    ],
)
def test_invalid_positions_and_impossible_parameters_are_refused(frames, wish):
    with raises(BAD_STRAYS, match="DEV-005"):
        group_strays(frames, **wish)


def tracks_of(frames, **options):
    """The positions (n, 3) of each identity."""
    by_identity = {}
    for frame, identities in zip(frames, identify_strays(frames, **options), strict=True):
        for identity, position in zip(identities.tolist(), frame, strict=True):
            by_identity.setdefault(identity, []).append(position)
    return {identity: np.array(positions) for identity, positions in by_identity.items()}


def test_a_sphere_keeps_its_identity_in_frames_of_any_order(spheres, random):
    frames = noisy_frames(spheres, random)
    by_place = np.array(frames).std(axis=0)
    tracks = tracks_of(frames)
    assert by_place.min() > 10.0  # what a student got who took the place in the list for the sphere
    assert sorted(tracks) == [0, 1, 2, 3, 4]
    for positions in tracks.values():
        assert len(positions) == 60
        assert positions.std(axis=0) == pytest.approx(NOISE_MM, rel=0.4)


def test_a_sphere_that_was_hidden_keeps_its_identity_and_a_new_one_gets_a_new_one(spheres, random):
    frames = [
        frame[np.linalg.norm(frame - spheres[0], axis=1) > 5.0] if 20 <= number < 45 else frame
        for number, frame in enumerate(noisy_frames(spheres, random))
    ]
    frames = [np.vstack([frame, [[500.0, 0, 0]]]) if n >= 30 else frame for n, frame in enumerate(frames)]
    counts = {identity: len(positions) for identity, positions in tracks_of(frames).items()}
    assert counts.pop(5) == 30
    assert sorted(counts.values()) == [35, 60, 60, 60, 60]


def test_spheres_that_meet_are_not_told_apart_by_a_guess(random):
    way = np.linspace(-40.0, 40.0, 60)
    frames = [
        random.permutation([[x, 0.5, -1500], [-x, -0.5, -1500]] + random.normal(size=(2, 3)) * 0.05)
        for x in way
    ]
    tracks = tracks_of(frames)
    unknown = tracks.pop(UNKNOWN)
    assert np.abs(unknown[:, 0]).max() < GATE_MM
    assert len(tracks) == 4  # two before they meet, two afterwards
    for positions in tracks.values():
        assert np.ptp(np.sign(positions[:, 0])) == 0.0


def test_a_tracker_that_moves_slowly_keeps_the_identities_and_a_jump_ends_all_of_them(spheres, random):
    slowly = [frame + np.array([0.0, 2.0 * n, 0.0]) for n, frame in enumerate(noisy_frames(spheres, random))]
    assert [len(one) for one in tracks_of(slowly).values()] == [60] * 5
    apart = np.array([[0.0, 0, 0], [30, 0, 0], [0, 70, 0]])
    before, after = noisy_frames(apart, random, 10), noisy_frames(apart + np.array([30.0, 0, 0]), random, 10)
    tracks = tracks_of(before + after)  # the first sphere is now where the second was
    assert [len(one) for one in tracks.values()] == [10] * 6


def test_a_sphere_hidden_while_the_others_move_gets_a_new_identity(spheres, random):
    frames = []
    for number, frame in enumerate(noisy_frames(spheres, random)):
        hidden = 20 <= number < 40
        seen = frame[np.linalg.norm(frame - spheres[0], axis=1) > 5.0] if hidden else frame
        frames.append(seen + np.array([0.0, 1.0 * number, 0.0]))
    assert sorted(len(one) for one in tracks_of(frames).values()) == [20, 20, 60, 60, 60, 60]


@given(data=st.data())
@settings(max_examples=60, deadline=None)
def test_no_identity_ever_stands_for_two_spheres_that_move_within_the_gate(data):
    random = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    count = data.draw(st.integers(1, 6))
    places = random.uniform(-12.0, 12.0, size=(count, 3))
    steps = random.normal(size=(count, 3)) * data.draw(st.floats(0.0, 2.0))
    frames, truth = [], []
    for _ in range(30):
        places = places + np.clip(steps, -GATE_MM / 2, GATE_MM / 2)
        order = random.permutation(count)
        frames.append(places[order])
        truth.append(order)
    owners = {}
    for identities, order in zip(identify_strays(frames), truth, strict=True):
        for identity, sphere in zip(identities.tolist(), order.tolist(), strict=True):
            owners.setdefault(identity, set()).add(sphere)
    owners.pop(UNKNOWN, None)
    assert all(len(spheres) == 1 for spheres in owners.values())


def test_tracks_have_the_trackers_own_clock_and_leave_out_repeated_and_doubtful_readings():
    def frame(number, validity, *strays):
        return TrackerFrame(Stamp(number, 100 + number, 0.0), validity, (), strays)

    near = StrayReading((0.0, 0.0, -1500.0), Validity.OK)
    outside = StrayReading((0.0, 0.0, -4000.0), Validity.OUT_OF_VOLUME)
    frames = [
        frame(0, Validity.OK, outside, near),
        frame(1, Validity.STALE, near),
        frame(2, Validity.OK, near),
    ]
    with pytest.warns(StrayWarning, match="outside the measuring volume are left out: 1 of 2"):
        (track,) = track_strays(frames)
    assert (track.identity, track.device_clock.tolist()) == (0, [100, 102])
    assert track.positions_mm.tolist() == [[0.0, 0.0, -1500.0]] * 2
    with pytest.warns(StrayWarning, match="there are no frames"):
        assert track_strays([]) == ()


@pytest.mark.parametrize("gate_mm", [0.0, -1.0, np.inf, np.nan])
def test_a_gate_that_is_no_distance_is_refused(gate_mm):
    with raises(BAD_STRAYS):
        identify_strays([], gate_mm=gate_mm)


def test_spheres_hidden_one_after_another_amid_reflections_keep_their_identity(spheres, random):
    frames = []
    for number, frame in enumerate(noisy_frames(spheres, random, 200)):
        hidden = max(0, min(4, number // 10 - 5, 18 - number // 10))  # from one to four, and back
        seen = frame[np.linalg.norm(frame[:, None] - spheres[hidden:], axis=-1).min(axis=1) < 5.0]
        glints = [[-45.0, 135, -1375], [-87, 178, -1990]] + random.normal(size=(2, 3)) * 4.0
        frames.append(np.vstack([seen, glints[random.random(2) < 0.4]]))
    tracks = sorted((positions for positions in tracks_of(frames).values()), key=len)[-5:]
    for track in tracks:
        assert np.linalg.norm(track - track[0], axis=1).max() < 2.0
    assert sum(len(track) for track in tracks) == sum(
        np.linalg.norm(frame[:, None] - spheres, axis=-1).min(axis=1).__lt__(5.0).sum() for frame in frames
    )


def test_what_is_seen_in_few_frames_is_left_out_unless_it_is_asked_for(spheres, random):
    frames = [
        TrackerFrame(
            Stamp(number, number, 0.0),
            Validity.OK,
            (),
            tuple(StrayReading(tuple(one), Validity.OK) for one in positions[: 5 if number % 4 else 4]),
        )
        for number, positions in enumerate([spheres] * 20)
    ]
    rarely = [one for number, one in enumerate(frames) if number > 15 or number % 4 == 0]
    assert [len(one.positions_mm) for one in track_strays(rarely)] == [8, 8, 8, 8]
    assert len(track_strays(rarely, least_share=0.0)) == 5
    with raises(BAD_STRAYS):
        track_strays(frames, least_share=1.5)


@pytest.mark.parametrize(
    ("markers_mm", "said"),
    [
        ([1, 2], "is no mapping"),
        ({"nope": [[0.0, 0.0, 0.0]]}, "a tool that no frame has: 'nope'"),
        ({"guide": [[0.0, 0.0]]}, r"the markers of guide have shape \(1, 2\)"),
        ({"guide": [[0.0, 0.0, 0.0], [0.06, 0.0, 0.0]]}, "give millimetres, not metres"),
    ],
)
def test_markers_that_cannot_be_a_tools_are_refused(markers_mm, said):
    tool = ToolReading("guide", Validity.MISSING, None, None, None)
    seen = TrackerFrame(Stamp(1, 1, 0.0), Validity.OK, (tool,), ())
    with pytest.raises(WrongArgument, match=f"(?i){said}"):
        track_strays([seen], markers_mm=markers_mm)
