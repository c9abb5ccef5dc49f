"""Tools with several faces, the minimum marker spread, and the order of the tracking rules."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ronna_hw.wire.polaris import PortStatus
from sim.polaris.measurement.tracking_rules import as_requested, fit_rigid_body, track
from sim.polaris.unit.tool_definition import ToolDefinition, parse_definition, write_definition
from sim.world.rigid import rotation_from_vector
from sim.world.scene.model import TrackerTool

FACE = ((0.0, 0.0, 0.0), (0.0, 50.0, 0.0), (30.0, 100.0, 0.0), (-30.0, 135.0, 0.0))
PLACE_MM = np.array([0.0, 0.0, -1500.0])


def one_face(**changes: object) -> ToolDefinition:
    definition = parse_definition(write_definition(TrackerTool(name="t", part_number="T", markers_mm=FACE)))
    return replace(definition, **changes)


def two_faces() -> ToolDefinition:
    """A roof: both faces slope by 30 degrees about y, with different patterns."""
    slopes = [rotation_from_vector((0.0, np.radians(angle), 0.0)) for angle in (-30.0, 30.0)]
    patterns = np.array(FACE), np.array([(0.0, 10.0, 0.0), (20.0, 65.0, 0.0), (5.0, 125.0, 0.0)])
    shifts = (-60.0, 0.0, 0.0), (60.0, 0.0, 0.0)
    markers = np.vstack([p @ s.T + t for p, s, t in zip(patterns, slopes, shifts, strict=True)])
    normals = np.vstack([np.tile(s[:, 2], (len(p), 1)) for p, s in zip(patterns, slopes, strict=True)])
    return one_face(markers_mm=markers, normals=normals, faces=(1, 1, 1, 1, 2, 2, 2), maximum_angle_deg=60.0)


def seen_turned(definition: ToolDefinition, turn_deg: float) -> np.ndarray:
    """All markers, measured without error, of a tool turned about y."""
    return definition.markers_mm @ rotation_from_vector((0.0, np.radians(turn_deg), 0.0)).T + PLACE_MM


def followed(definition: ToolDefinition, turns_deg: list[float]) -> list[int]:
    """Faces tracked while the tool turns."""
    face, faces = 0, []
    numbers = list(range(len(definition.markers_mm)))
    for turn in turns_deg:
        measured = seen_turned(definition, turn)
        face = track(definition, numbers, measured, [True] * len(numbers), face).face
        faces.append(face)
    return faces


def test_the_face_towards_the_unit_is_tracked_and_the_other_is_unused() -> None:
    definition = two_faces()
    tracked = track(definition, list(range(7)), seen_turned(definition, 25.0), [True] * 7)
    assert tracked.face == 1
    assert tracked.information == 0x10
    assert tracked.marker_digits == (3, 3, 3, 3, 0, 0, 0)
    other = track(definition, list(range(7)), seen_turned(definition, -25.0), [True] * 7)
    assert other.face == 2
    assert other.information == 0x20
    assert other.marker_digits == (0, 0, 0, 0, 3, 3, 3)


def test_switching_between_faces_has_a_hysteresis_of_two_degrees() -> None:
    definition = two_faces()
    turns = np.arange(-6.0, 6.01, 0.1)
    away = followed(definition, turns.tolist())
    back = followed(definition, turns[::-1].tolist())
    change_away = turns[away.index(1)]
    change_back = turns[::-1][back.index(2)]
    # a turn by 1 degree changes the difference between the faces by 2 degrees
    assert change_away - change_back == pytest.approx(2.0, abs=0.25)


def test_a_face_of_markers_back_to_back_is_tracked_from_either_side() -> None:
    roof = two_faces()
    up, down = (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)
    definition = replace(
        roof, normals=np.vstack([(up, down, up, down), roof.normals[4:]]), maximum_angle_deg=180.0
    )
    assert followed(definition, [25.0, -25.0]) == [1, 1]


def test_a_disabled_face_is_never_tracked() -> None:
    definition = two_faces()
    measured = seen_turned(definition, 25.0)
    assert track(definition, list(range(7)), measured, [True] * 7, 0, 0b10).face == 2
    none = track(definition, list(range(7)), measured, [True] * 7, 0, 0b100)
    assert none.pose is None
    assert none.information == 0x02


def test_markers_with_too_little_spread_give_no_pose() -> None:
    measured = np.array(FACE) + PLACE_MM
    wide = one_face(minimum_spread_mm=(100.0, 40.0, 0.0))
    assert track(wide, [0, 1, 2, 3], measured, [True] * 4).pose is not None
    wider = one_face(minimum_spread_mm=(150.0, 40.0, 0.0))
    narrow = track(wider, [0, 1, 2, 3], measured, [True] * 4)
    assert narrow.pose is None
    assert narrow.information == 0x01


def test_the_first_tracking_rule_that_a_marker_breaks_is_reported() -> None:
    """A marker beyond the angle, outside the volume and badly placed."""
    normals = np.tile((0.0, 0.0, 1.0), (4, 1))
    normals[1] = (0.0, 1.0, 0.0)
    definition = one_face(normals=normals, maximum_angle_deg=60.0)
    measured = np.array(FACE) + PLACE_MM
    tracked = track(definition, [0, 1, 2, 3], measured, [True, False, True, True])
    assert tracked.marker_digits == (3, 1, 3, 3)
    assert tracked.pose is not None
    dropped = track(one_face(), [0, 1, 2, 3], measured, [True, False, True, True])
    assert dropped.marker_digits == (3, 4, 3, 3)
    assert dropped.volume_status == PortStatus(0)


def test_markers_outside_the_volume_are_used_only_if_needed_and_requested() -> None:
    measured = np.array(FACE) + PLACE_MM
    tracked = track(one_face(), [0, 1, 2, 3], measured, [True, False, False, True])
    assert tracked.volume_status == PortStatus.PARTIALLY_OUT_OF_VOLUME
    requested = as_requested(tracked, outside=True, partially_outside=False)
    assert requested.marker_digits == (3, 5, 5, 3)
    unrequested = as_requested(tracked, outside=False, partially_outside=False)
    assert unrequested.pose is None
    assert unrequested.marker_digits == (3, 4, 4, 3)
    assert unrequested.information & 0x02


def test_a_marker_minimum_above_three_is_respected() -> None:
    measured = np.array(FACE) + PLACE_MM
    tracked = track(one_face(minimum_markers=4), [0, 1, 3], measured[[0, 1, 3]], [True] * 3)
    assert tracked.pose is None
    assert tracked.information == 0x02
    assert tracked.marker_digits == (0, 0, 0, 0)


def test_a_marker_beyond_the_maximum_error_is_reported_and_left_out() -> None:
    markers = np.array([*FACE, (60.0, 40.0, 0.0), (-70.0, 80.0, 0.0)])
    definition = one_face(
        markers_mm=markers, normals=np.tile((0.0, 0.0, 1.0), (6, 1)), faces=(1,) * 6, maximum_error_mm=1.0
    )
    measured = markers + PLACE_MM
    measured[5, 2] += 3.0
    tracked = track(definition, list(range(6)), measured, [True] * 6)
    assert tracked.marker_digits[5] == 2
    assert tracked.pose is not None
    assert tracked.pose.position_mm == pytest.approx(tuple(PLACE_MM), abs=1e-6)


def test_a_fit_recovers_the_original_pose() -> None:
    generator = np.random.default_rng(11)
    for _ in range(50):
        body = generator.uniform(-80.0, 80.0, (4, 3))
        rotation = rotation_from_vector(generator.uniform(-2.0, 2.0, 3))
        shift = generator.uniform(-500.0, 500.0, 3)
        found = fit_rigid_body(body, body @ rotation.T + shift)
        assert np.allclose(found[0], rotation, atol=1e-9)
        assert np.allclose(found[1], shift, atol=1e-7)
        assert found[2].max() < 1e-9


def test_a_mirror_image_is_never_fitted() -> None:
    body = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [0.0, 90.0, 0.0], [10.0, 20.0, 40.0]])
    rotation, _, distances = fit_rigid_body(body, body * (1.0, 1.0, -1.0))
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    assert distances.max() > 5.0


def test_a_planar_body_is_fitted_without_a_flip() -> None:
    body = np.array([[0.0, 0.0, 0.0], [60.0, 0.0, 0.0], [0.0, 90.0, 0.0], [-44.0, 40.0, 0.0]])
    rotation, _, distances = fit_rigid_body(body, body + np.random.default_rng(3).normal(0.0, 0.1, (4, 3)))
    assert np.linalg.norm(rotation - np.eye(3)) < 0.02
    assert distances.max() < 0.5
