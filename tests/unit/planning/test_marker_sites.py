"""Markers are placed to serve the planned targets, and their claimed errors hold in random trials."""

from __future__ import annotations

import numpy as np
import pytest

from procedures.planning.errors import NoMarkerSites
from procedures.planning.head_in_ct import HeadEllipsoid
from procedures.planning.marker_sites import (
    APART_MM,
    CLEAR_OF_WAY_MM,
    propose_further,
    propose_markers,
)
from procedures.registration.error_theory import tre_principal_axes_mm
from procedures.registration.rigid_fit import fit_rigid
from procedures.reporting.marker_picture import marker_picture
from procedures.strategies.trajectory import Trajectory

HEAD = HeadEllipsoid(centre_mm=(3.0, -40.0, 810.0), semi_axes_mm=(75.0, 95.0, 90.0))
TRAJECTORIES = (
    Trajectory("T1", (30.0, -90.0, 880.0), (20.0, -45.0, 820.0)),
    Trajectory("T2", (-25.0, -80.0, 885.0), (-10.0, -50.0, 800.0)),
)
TRIALS = 20_000
ERROR_MM = 0.3


@pytest.mark.parametrize("count", [3, 4, 5, 8])
def test_markers_keep_apart_clear_of_the_paths_and_serve_every_target_better_than_by_chance(
    count: int,
) -> None:
    found = propose_markers(HEAD, TRAJECTORIES, count, ERROR_MM)
    centres = np.array(found.centres_mm)
    apart = np.linalg.norm(centres[:, None] - centres, axis=2)[np.triu_indices(count, 1)]
    assert apart.min() >= APART_MM - 0.01
    for one in TRAJECTORIES:
        away = centres - one.target_mm
        aside = away - np.outer(away @ one.axis_ct, one.axis_ct)
        assert np.linalg.norm(aside, axis=1).min() >= CLEAR_OF_WAY_MM - 0.01
    assert all(target.expected_mm < target.usual_mm for target in found.targets)


def test_one_more_marker_helps_every_target_more_than_a_proposed_one_that_is_elsewhere() -> None:
    every = np.array(propose_markers(HEAD, TRAJECTORIES, 5, ERROR_MM).centres_mm)
    present = every[:4]
    found = propose_further(HEAD, TRAJECTORIES, present, ERROR_MM)
    assert np.linalg.norm(present - found.centre_mm, axis=1).min() >= APART_MM - 0.01
    assert [name for name, _, _ in found.targets] == ["T1", "T2"]
    assert all(after < now for _, now, after in found.targets)
    fifth = tre_principal_axes_mm(np.array([one.target_mm for one in TRAJECTORIES]), every, ERROR_MM)
    assert sum(after**2 for _, _, after in found.targets) <= np.square(fifth).sum() + 1e-6


def test_the_claimed_errors_match_random_trials() -> None:
    found = propose_markers(HEAD, TRAJECTORIES, 5, ERROR_MM)
    centres, random = np.array(found.centres_mm), np.random.default_rng(0)
    seen = centres + random.normal(0.0, ERROR_MM / np.sqrt(3.0), (TRIALS, 5, 3))
    fit = fit_rigid(np.broadcast_to(centres, seen.shape), seen)
    for one, claimed in zip(TRAJECTORIES, found.targets, strict=True):
        error = fit.rotation @ np.array(one.target_mm) + fit.translation_mm - one.target_mm
        rms_mm = np.sqrt(np.mean(np.square(error).sum(axis=-1)))
        assert rms_mm == pytest.approx(claimed.expected_mm, rel=0.03)


def test_a_head_without_room_for_the_markers_is_refused() -> None:
    small = HeadEllipsoid(centre_mm=(0.0, 0.0, 0.0), semi_axes_mm=(25.0, 25.0, 25.0))
    with pytest.raises(NoMarkerSites, match=r"PLAN-021.*8 markers"):
        propose_markers(small, (Trajectory("T1", (0.0, -25.0, 25.0), (0.0, 0.0, 0.0)),), 8, ERROR_MM)
    around = np.random.default_rng(0).normal(0.0, 25.0, (200, 3))
    with pytest.raises(NoMarkerSites, match=r"PLAN-021.*one more marker"):
        propose_further(small, TRAJECTORIES, around, ERROR_MM)


def test_the_marker_picture_is_a_png() -> None:
    found = propose_markers(HEAD, TRAJECTORIES, 4, ERROR_MM)
    assert marker_picture(found, HEAD, TRAJECTORIES).startswith(b"\x89PNG")
