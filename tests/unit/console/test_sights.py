"""The tracker's volume and the lines of sight, as the scene draws them."""

from __future__ import annotations

import pytest

from console.scene.sights import is_hidden, volume_edges
from procedures.engine.events import Bodies, Body, MeasuringVolume, Pose

EYE, SPHERE = (0.0, 0.0, 0.0), (1000.0, 0.0, 0.0)


def test_a_measuring_volume_is_drawn_as_its_sections_and_the_edges_between_them() -> None:
    volume = MeasuringVolume(device="tracker", sections_mm=((-950.0, 200.0, 300.0), (-2400.0, 600.0, 700.0)))
    edges = volume_edges(volume)
    assert len(edges) == 12
    assert ((-200.0, -300.0, -950.0), (200.0, -300.0, -950.0)) in edges
    assert ((200.0, 300.0, -950.0), (600.0, 700.0, -2400.0)) in edges
    assert volume_edges(None) == []


@pytest.mark.parametrize(("beside_mm", "hidden"), [(0.0, True), (39.0, True), (41.0, False)])
def test_a_body_that_intersects_a_line_of_sight_hides_it(beside_mm: float, hidden: bool) -> None:
    bodies = Bodies(moving=(Body(name="forearm", radius_mm=40.0),), fixed=(), pairs=())
    axis = (500.0, beside_mm, -200.0, 500.0, beside_mm, 200.0)
    pose = Pose(arm="arm", joints_rad=(0.0,), age_s=0.0, bodies_mm=(axis,))
    assert is_hidden(EYE, SPHERE, bodies, pose) is hidden


def test_a_pose_without_matching_bodies_hides_nothing() -> None:
    bodies = Bodies(moving=(Body(name="forearm", radius_mm=40.0),), fixed=(), pairs=())
    assert not is_hidden(EYE, SPHERE, bodies, Pose(arm="arm", joints_rad=(0.0,), age_s=0.0))
