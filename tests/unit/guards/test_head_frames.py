"""The spheres frame by frame: a half-hidden head does not count as moved."""

import numpy as np
import pytest
from numpy.typing import NDArray

from procedures.guards.head_frames import FAR_READINGS, HeadFrames
from ronna_hw.devices.readings import Stamp, StrayReading, TrackerFrame, Validity

SPHERES_MM = np.array(
    [[0.0, 0.0, -1900.0], [60.0, 10.0, -1890.0], [15.0, 75.0, -1905.0], [80.0, 90.0, -1880.0]]
)


def watched(places_mm: NDArray[np.float64]) -> HeadFrames:
    """After enough readings that show spheres at these places."""
    strays = tuple(StrayReading((x, y, z), Validity.OK) for x, y, z in places_mm.tolist())
    head = HeadFrames(SPHERES_MM)
    for _ in range(FAR_READINGS):
        head.take(TrackerFrame(Stamp(1, 1, 0.0), Validity.OK, (), strays))
    return head


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
