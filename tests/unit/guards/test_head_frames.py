"""The spheres frame by frame: a half-hidden head does not count as moved."""

import numpy as np
import pytest
from numpy.typing import NDArray

from procedures.guards.head_frames import AVERAGED, FAR_READINGS, PATIENT_LIMIT_MM, SPAN, HeadFrames
from procedures.guards.room_reading import find_ghosts
from procedures.registration.movement import LEAST_POINTS
from ronna_hw.devices.crossed_sight import SENSORS_MM
from ronna_hw.devices.readings import Stamp, StrayReading, TrackerFrame, Validity

SPHERES_MM = np.array(
    [[0.0, 0.0, -1900.0], [60.0, 10.0, -1890.0], [15.0, 75.0, -1905.0], [80.0, 90.0, -1880.0]]
)


def watched(places_mm: NDArray[np.float64]) -> HeadFrames:
    """After enough readings that show spheres at these places."""
    head = HeadFrames(SPHERES_MM)
    for _ in range(FAR_READINGS):
        head.add_frame(showing(places_mm))
    return head


def showing(places_mm: NDArray[np.float64]) -> TrackerFrame:
    strays = tuple(StrayReading((x, y, z), Validity.OK) for x, y, z in places_mm.tolist())
    return TrackerFrame(Stamp(1, 1, 0.0), Validity.OK, (), strays)


@pytest.mark.hazard(12)
def test_a_head_that_moved_far_is_recognised_by_its_sphere_layout() -> None:
    head = watched(SPHERES_MM[:3] + np.array([0.0, 25.0, 5.0]))
    assert head.moved_mm == pytest.approx(np.hypot(25.0, 5.0))


@pytest.mark.hazard(14)
def test_two_spheres_in_place_and_a_phantom_do_not_count_as_a_moved_head() -> None:
    first, second, third, _ = SPHERES_MM
    along = (second - first) / np.linalg.norm(second - first)
    away = third - first - ((third - first) @ along) * along
    mirrored = third - 2.0 * away  # with the first two it has the distances of three spheres
    head = watched(np.vstack([first, second, mirrored]))
    assert head.moved_mm is None
    assert not head.seen


@pytest.mark.hazard(12)
@pytest.mark.parametrize("hidden", [[0, 1, 2, 3], [0, 1], [3]], ids=["in turn", "two in turn", "always one"])
def test_a_head_that_moved_is_recognised_although_a_sphere_is_hidden_in_every_frame(
    hidden: list[int],
) -> None:
    head = HeadFrames(SPHERES_MM)
    for number in range(SPAN):
        head.add_frame(
            showing(np.delete(np.add(SPHERES_MM, (3.0, 0.0, 0.0)), hidden[number % len(hidden)], axis=0))
        )
    assert head.moved_mm == pytest.approx(3.0)


@pytest.mark.hazard(12)
def test_frames_that_never_say_whether_the_head_moved_do_not_count_as_seen() -> None:
    many = np.vstack([SPHERES_MM, np.add(SPHERES_MM, (0.0, 150.0, 0.0))])
    head = HeadFrames(many)
    for number in range(SPAN + 1):
        shown = [(number + one) % len(many) for one in range(LEAST_POINTS)]  # each in three of eight
        head.add_frame(showing(many[shown]))
    assert head.moved_mm is None
    assert not head.seen


@pytest.mark.hazard(14)
def test_one_sphere_that_alone_is_elsewhere_does_not_make_a_moved_head() -> None:
    places_mm = SPHERES_MM.copy()
    places_mm[3] += (0.0, 0.0, 5.0)  # a glint beside a hidden one
    head = HeadFrames(SPHERES_MM)
    for _ in range(AVERAGED):
        head.add_frame(showing(places_mm))
    assert head.moved_mm == pytest.approx(0.0)


# Spheres, tracker frame, and what one frame of a case with two arms showed: the first sphere was hidden from
# one sensor, and its line crossed that to a marker of the frame on the arm.
WITH_ARMS_MM = np.array(
    [
        [-8.15, -137.03, -1984.29],
        [-43.81, -109.5, -2052.06],
        [13.53, -210.25, -1975.55],
        [-72.2, -231.59, -1997.78],
    ]
)
GHOST_MM = np.array([-8.18, -136.62, -1990.91])


@pytest.mark.hazard(12)
@pytest.mark.hazard(14)
def test_a_ghost_beside_a_hidden_sphere_does_not_make_a_moved_head_and_a_moved_sphere_does() -> None:
    other_mm = (GHOST_MM + 0.1 * (GHOST_MM - SENSORS_MM[1]))[
        None
    ]  # a marker behind it, from the second sensor
    found = {}
    for name, markers_mm in (("ghost", other_mm), ("moved", np.empty((0, 3)))):
        head = HeadFrames(WITH_ARMS_MM)
        for number in range(SPAN):
            shown = WITH_ARMS_MM.copy()
            shown[0] = GHOST_MM if number % 3 else WITH_ARMS_MM[0]
            shown = np.delete(shown, 2, axis=0)
            head.add_frame(
                showing(shown),
                lambda spheres, points, others=markers_mm: find_ghosts(spheres, others, points),
            )
        found[name] = head.moved_mm
    assert found["ghost"] is None or found["ghost"] < PATIENT_LIMIT_MM
    assert found["moved"] is not None
    assert found["moved"] > PATIENT_LIMIT_MM


@pytest.mark.hazard(12)
@pytest.mark.hazard(14)
def test_a_ghost_close_to_the_place_of_one_of_three_spheres_leaves_the_other_two_to_show_the_head() -> None:
    found = {}
    for shift_mm in (0.0, 0.5):
        head = HeadFrames(WITH_ARMS_MM)
        shown = np.add(WITH_ARMS_MM, (shift_mm, 0.0, 0.0))[:3]
        way = WITH_ARMS_MM[0] - SENSORS_MM[0]
        shown[0] = WITH_ARMS_MM[0] + 0.8 * way / np.linalg.norm(way)
        other_mm = SENSORS_MM[1] + 0.9 * (shown[0] - SENSORS_MM[1])
        for _ in range(AVERAGED):
            head.add_frame(
                showing(shown),
                lambda spheres, points, other=other_mm: find_ghosts(spheres, other[None], points),
            )
        # The arm has moved: the sphere is in view again, and no line crosses there.
        head.add_frame(showing(np.add(WITH_ARMS_MM, (shift_mm, 0.0, 0.0))[:3]))
        found[shift_mm] = head.moved_mm
    assert found == {0.0: pytest.approx(0.0), 0.5: pytest.approx(0.5)}
