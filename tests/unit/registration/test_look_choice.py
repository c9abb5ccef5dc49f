"""Choice of looks: predicted as the adjustment will find it, every sphere seen, none beyond its worth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from procedures.registration.arm_adjustment import best_influence
from procedures.registration.arm_hypotheses import Source, share_by_sphere
from procedures.registration.look_choice import Candidates, ChosenLooks, choose_looks
from procedures.registration.target_prediction import IndependentErrors, SharedErrors, predict_by_influence
from ronna_hw.arrays import Array

SPHERES = np.array([[80.0, 0, 0], [0, 90, 20], [-70, -10, 40], [10, -80, 0]])
OF_SPHERE = tuple(range(4)) * 3  # each from three sides
POINTS = SPHERES[list(OF_SPHERE)]
TARGETS = np.array([[5.0, 10.0, -40.0], [-20.0, 15.0, -30.0]])
NOISE_MM, CT_MM = 0.02, 0.05


def candidates() -> tuple[Candidates, Array]:
    """Return looks of an arm with three errors, and their displacements (t, 3, k) at the targets."""
    arm = 0.2 * np.random.default_rng(2).normal(size=(len(POINTS) + 2, 3, 3))
    looks = Candidates(
        OF_SPHERE,
        POINTS,
        np.full(len(POINTS), 5.0),
        arm[:-2],
        np.tile(np.eye(3) * CT_MM**2, (4, 1, 1)),
        np.eye(3) * NOISE_MM**2,
    )
    return looks, arm[-2:]


def predicted_rms_mm(looks: Candidates, at_targets: Array, chosen: tuple[int, ...]) -> float:
    """Return the rms error over the targets that the adjustment of the chosen looks predicts."""
    kept, nothing = list(chosen), np.zeros((3, 3))
    spheres = [OF_SPHERE[one] for one in kept]
    ct = IndependentErrors("CT", looks.sphere_mm2[spheres], nothing)
    noise = IndependentErrors("noise", np.tile(looks.look_mm2, (len(kept), 1, 1)), nothing)
    squares = []
    for target, arm in zip(TARGETS, at_targets, strict=True):
        sources: list[Source] = [
            SharedErrors("arm", looks.arm_mm[kept], arm),
            noise,
            share_by_sphere(ct, spheres),
        ]
        influence = best_influence(POINTS[kept], target, sources)
        squares.append(predict_by_influence(influence, sources).rms_mm ** 2)
    return float(np.sqrt(np.mean(squares)))


def choose(most: int, least_gain_mm_per_s: float = 0.0) -> ChosenLooks:
    looks, at_targets = candidates()
    return choose_looks(looks, TARGETS, at_targets, most, least_gain_mm_per_s)


def test_the_stated_error_of_all_looks_is_that_of_the_adjustment_and_exchanges_have_lowered_it() -> None:
    looks, at_targets = candidates()
    for count in range(5, 9):
        found = choose(count)
        expected = predicted_rms_mm(looks, at_targets, found.candidates)
        assert found.rms_mm[-1] == pytest.approx(expected, rel=1e-3)
        assert found.rms_mm[-1] < found.rms_mm[-2]


def test_each_look_after_the_spheres_is_the_one_that_lowers_the_error_most() -> None:
    looks, at_targets = candidates()
    found = choose(7).candidates
    for count in range(4, 7):
        left = [one for one in range(len(POINTS)) if one not in found[:count]]
        best = min(left, key=lambda one: predicted_rms_mm(looks, at_targets, (*found[:count], one)))
        assert found[count] == best


def test_every_sphere_is_seen_first_and_no_look_is_taken_twice() -> None:
    found = choose(len(POINTS)).candidates
    assert sorted(OF_SPHERE[one] for one in found[:4]) == [0, 1, 2, 3]
    assert sorted(found) == list(range(len(POINTS)))


def test_a_look_that_is_not_worth_its_seconds_is_not_taken() -> None:
    every, few = choose(len(POINTS)), choose(len(POINTS), 0.0005)
    assert 4 <= len(few.candidates) < len(POINTS)
    assert len(every.candidates) > len(few.candidates)
    gain_mm = every.rms_mm[len(few.candidates) - 1] - every.rms_mm[len(few.candidates)]
    assert gain_mm / 5.0 < 0.0005


def test_of_two_equal_looks_the_one_that_takes_less_time_is_taken() -> None:
    looks, at_targets = candidates()
    twins = replace(
        looks,
        spheres=OF_SPHERE * 2,
        points_mm=np.tile(POINTS, (2, 1)),
        seconds=np.repeat([8.0, 4.0], len(POINTS)),
        arm_mm=np.tile(looks.arm_mm, (2, 1, 1)),
    )
    found = choose_looks(twins, TARGETS, at_targets, 6, 0.0).candidates
    assert all(one >= len(POINTS) for one in found[:4])
