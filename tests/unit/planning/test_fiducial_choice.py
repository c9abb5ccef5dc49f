"""The planner expects the error by skin and screws, and names the fewest screws that keep the margins."""

from __future__ import annotations

from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest
from prepared_results import plan

from procedures.planning.fiducial_choice import (
    OTHERS_MM,
    compare_fiducials,
    expect_with_skin,
    name_fewest,
)
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.marker_sites import CRANIUM, list_free_sites
from procedures.registration.surface.regions import HeadAxes
from procedures.registration.surface.surface import Surface

AXES_MM = np.array([75.0, 95.0, 90.0])
HEAD = HeadEllipsoid(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=(75.0, 95.0, 90.0))
SCREWS_MM = np.array([[30.0, -50.0, 70.0], [-40.0, -30.0, 75.0], [5.0, -85.0, 45.0]])


@pytest.fixture(scope="module")
def skin() -> Surface:
    """Samples of an ellipsoid's skin, evenly spread."""
    directions = np.random.default_rng(1).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    normals = directions / AXES_MM
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return cast(Surface, SimpleNamespace(points_mm=directions * AXES_MM, normals=normals))


def test_every_screw_lowers_the_expected_error_at_every_target(skin: Surface) -> None:
    found = [expect_with_skin(skin, SCREWS_MM[:count], plan()) for count in range(4)]
    by_target = np.array([[one.rms_mm for one in way.expected] for way in found])
    assert (np.diff(by_target, axis=0) < 0.0).all()
    assert found[0].words == "skin alone"
    assert found[1].words == "skin and 1 screw"


def test_the_fewest_screws_that_keep_the_margin_are_named(skin: Surface) -> None:
    compared = compare_fiducials(skin, HEAD, plan())
    assert [len(one.centres_mm) for one in compared] == [0, 1, 2, 3, 5]
    worst_mm = [max(at.total_limit_mm for at in one.expected) for one in compared]
    assert worst_mm[:4] == sorted(worst_mm[:4], reverse=True)
    between_mm = 0.5 * (worst_mm[1] + worst_mm[2])  # one screw is beyond it, two are within
    tight = compare_fiducials(skin, HEAD, plan(margin_mm=between_mm))
    assert name_fewest(tight) == "skin and 2 screws: the fewest screws that keep every margin"
    assert not tight[1].keeps_margins
    assert name_fewest(compare_fiducials(skin, HEAD, plan(margin_mm=OTHERS_MM))).startswith("nothing keeps")


def test_screws_are_apart_and_a_second_comparison_is_the_same(skin: Surface) -> None:
    first, again = (compare_fiducials(skin, HEAD, plan()) for _ in range(2))
    assert first == again
    centres = np.array(first[3].centres_mm)
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)[np.triu_indices(3, 1)]
    assert apart.min() > 38.0


def test_no_screw_is_proposed_below_the_cranium(skin: Surface) -> None:
    stretched = np.array([1.0, 1.0, 1.6])  # a long head, of which the cap of sites reaches the eyes
    long_head = HeadEllipsoid(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=(75.0, 95.0, 144.0))
    face = cast(Surface, SimpleNamespace(points_mm=skin.points_mm * stretched, normals=skin.normals))
    axes = HeadAxes.of(face)
    ways = [one.trajectory for one in plan().trajectories]
    everywhere, on_cranium = (
        set(axes.name_parts(list_free_sites(long_head, ways, None, np.random.default_rng(0), one)[0]))
        for one in (None, axes)
    )
    assert {"eyes", "nose"} <= everywhere
    assert on_cranium <= set(CRANIUM)
    for one in compare_fiducials(face, long_head, plan()):
        if one.centres_mm:
            assert set(axes.name_parts(np.array(one.centres_mm))) <= set(CRANIUM)
