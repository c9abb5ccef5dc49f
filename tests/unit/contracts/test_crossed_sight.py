"""Phantoms of a stereo tracker among tracks: spheres are not accused, crossings of lines of sight are."""

from __future__ import annotations

import warnings

import numpy as np
import pytest

from ronna_hw.devices.crossed_sight import SENSORS_MM, find_crossed_sights
from ronna_hw.devices.readings import Stamp, StrayReading, ToolReading, TrackerFrame, Validity
from ronna_hw.devices.stray_tracks import StrayTrack, StrayWarning, track_strays
from ronna_hw.vectors import Vector3

NOISE_MM = np.array([0.06, 0.06, 0.2])
FRAMES = 30
HEAD_MM = np.array([0.0, 0.0, -1800.0])
PAIR_MM = np.array([(20.0, -40.0, -1780.0), (20.0, 45.0, -1800.0)])  # in one plane with both sensors, nearly


def crossings_of(places_mm: np.ndarray) -> np.ndarray:
    """Both points at which the lines to two markers cross, midway between them."""
    eyes = np.array(SENSORS_MM)
    found = []
    for one, other in (places_mm, places_mm[::-1]):
        a, b = one - eyes[0], other - eyes[1]
        along = np.linalg.lstsq(np.stack([a, -b], axis=1), eyes[1] - eyes[0], rcond=None)[0]
        found.append((eyes[0] + along[0] * a + eyes[1] + along[1] * b) / 2.0)
    return np.array(found)


def in_plane(apart_mm: float) -> np.ndarray:
    """Two spheres whose lines of sight pass each other at about that distance."""
    scale = PAIR_MM[1, 2] / PAIR_MM[0, 2]
    return PAIR_MM * [[1, 1, 1], [scale, 1, 1]] + [[0, 0, 0], [apart_mm, 0, 0]]


def tracks_of(
    places_mm: np.ndarray,
    tools: tuple[ToolReading, ...] = (),
    markers_mm: dict[str, list[Vector3]] | None = None,
) -> tuple[StrayTrack, ...]:
    random = np.random.default_rng(5)
    frames = []
    for number in range(FRAMES):
        seen = places_mm + random.normal(size=places_mm.shape) * NOISE_MM
        strays = tuple(StrayReading(tuple(one), Validity.OK) for one in seen.tolist())
        frames.append(TrackerFrame(Stamp(number, number, number / 60.0), Validity.OK, tools, strays))
    return track_strays(frames, markers_mm=markers_mm)


def test_spheres_on_heads_are_not_accused() -> None:
    random = np.random.default_rng(3)
    for count in (1, 2, 3, 5, 8):
        for _ in range(60):
            spheres_mm = HEAD_MM + random.uniform(-110.0, 110.0, (count, 3))
            assert find_crossed_sights(spheres_mm) == ()


def test_lines_that_pass_farther_apart_than_the_trackers_error_tell_phantoms_from_spheres() -> None:
    spheres_mm = in_plane(3.5)
    with pytest.warns(StrayWarning) as warned:
        tracks_of(np.vstack([spheres_mm, [(-90.0, 10.0, -1850.0)], crossings_of(spheres_mm)]))
    text = str(warned[0].message)
    assert "track 3 is where lines of sight to tracks 0 and 1 cross: a phantom" in text
    assert "track 4 is where lines of sight to tracks 1 and 0 cross: a phantom" in text
    assert "at most half" not in text
    assert warned[0].filename == __file__


def test_one_phantom_whose_twin_is_not_seen_is_told_from_the_spheres_however_close_the_lines_pass() -> None:
    spheres_mm = in_plane(0.3)
    with pytest.warns(StrayWarning, match="track 2 is where lines of sight to tracks 0 and 1 cross"):
        tracks_of(np.vstack([spheres_mm, crossings_of(spheres_mm)[:1]]))


def test_a_phantom_of_a_sphere_and_a_marker_of_a_tool_is_told_where_the_markers_are_given() -> None:
    (marker_mm, sphere_mm), phantoms_mm = in_plane(0.3), crossings_of(in_plane(0.3))
    tool = ToolReading("robot_frame", Validity.OK, (1.0, 0.0, 0.0, 0.0), tuple(marker_mm.tolist()), 0.05)
    strays_mm = np.vstack([sphere_mm, phantoms_mm[:1]])
    assert len(tracks_of(strays_mm, (tool,))) == 2  # without a warning: nothing says where the marker is
    with pytest.warns(StrayWarning, match=r"track 1 is where .* marker 1 of robot_frame and track 0 cross"):
        tracks_of(strays_mm, (tool,), {"robot_frame": [(0.0, 0.0, 0.0)]})


def test_strays_outside_the_measuring_volume_are_left_out_with_a_word() -> None:
    strays = (StrayReading((0.0, 0.0, -2600.0), Validity.OUT_OF_VOLUME),)
    frames = [TrackerFrame(Stamp(n, n, n / 60.0), Validity.OK, (), strays) for n in range(FRAMES)]
    with pytest.warns(StrayWarning, match="outside the measuring volume are left out: 30 of 30 frames"):
        assert track_strays(frames) == ()


def test_two_spheres_and_their_two_phantoms_that_nothing_tells_apart_are_named_together() -> None:
    spheres_mm = in_plane(0.3)
    others_mm = np.array([(-90.0, 10.0, -1850.0)])
    with pytest.warns(StrayWarning, match=r"tracks 1, 2, 3, 4 are each .* at most half of them are spheres"):
        tracks_of(np.vstack([others_mm, spheres_mm, crossings_of(spheres_mm)]))


def test_spheres_in_one_plane_with_both_sensors_are_no_phantoms_by_themselves() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert len(tracks_of(in_plane(0.0))) == 2
