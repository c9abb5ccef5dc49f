"""Table 4 as one experiment: the fit reaches the published means in the full simulation and moves no more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from procedures.strategies.trajectory import reference_direction
from studies.strategies.experiment_tables import tables
from studies.strategies.one_experiment import (
    CELLS,
    MOVABLE,
    NUMBERS,
    OF_TOOL,
    OneExperimentStudy,
    Trials,
    condition,
)

pytestmark = pytest.mark.slow  # its trials take ten seconds to plan

ARMS = range(2)
COUNTS = (3, 4, 5)


@pytest.fixture(scope="module")
def trials() -> Trials:
    """One place is enough for the fit; the study has eight."""
    return Trials.plan(0, ARMS, places=(1,))


def test_an_arm_fitted_to_table_4_shows_its_means_in_the_full_simulation(trials: Trials) -> None:
    fitted = np.array([condition(trials.linear(arm), trials.drawn[arm], CELLS) for arm in ARMS])
    as_drawn, given = trials.simulate(trials.drawn), trials.simulate(fitted)

    def misfit(lengths: dict[str, np.ndarray]) -> float:
        apart = [
            lengths[of][..., COUNTS.index(count)].mean(axis=(1, 2)) / row.mean_mm - 1.0
            for (of, count), row in CELLS.items()
        ]
        return float(np.abs(apart).max())

    assert misfit(as_drawn) > 0.4
    assert misfit(given) < 0.1
    nos = given["nos"].mean(axis=(1, 2))
    assert (nos[:, 0] - nos[:, 1] > 0.1).all()
    assert (nos[:, 1] - nos[:, 2] > 0.03).all()


def test_the_linear_errors_are_those_of_the_simulation(trials: Trials) -> None:
    simulated = trials.simulate(trials.drawn)
    for arm in ARMS:
        means, _ = trials.linear(arm).means(trials.drawn[arm], list(CELLS))
        expected = [simulated[of][arm, ..., COUNTS.index(count)].mean() for of, count in CELLS]
        np.testing.assert_allclose(means, expected, atol=0.02)


def test_the_gradient_of_the_means_is_their_difference_quotient(trials: Trials) -> None:
    linear, here, step = trials.linear(0), trials.drawn[0], 1e-5
    _, gradient = linear.means(here, list(CELLS))
    for number in range(NUMBERS):
        there = here + step * (np.arange(NUMBERS) == number)
        quotient = (linear.means(there, list(CELLS))[0] - linear.means(here, list(CELLS))[0]) / step
        np.testing.assert_allclose(gradient[:, number], quotient, atol=1e-4)


def test_an_arm_that_already_shows_the_means_is_left_as_drawn(trials: Trials) -> None:
    linear, drawn = trials.linear(0), trials.drawn[0]
    means, _ = linear.means(drawn, list(CELLS))
    own = {
        cell: replace(row, mean_mm=float(mean))
        for (cell, row), mean in zip(CELLS.items(), means, strict=True)
    }
    np.testing.assert_allclose(condition(linear, drawn, own), drawn, atol=1e-6)


def test_only_the_numbers_allowed_to_move_are_fitted(trials: Trials) -> None:
    for movable in MOVABLE.values():
        moved = condition(trials.linear(0), trials.drawn[0], CELLS, movable) != trials.drawn[0]
        np.testing.assert_array_equal(moved, movable)
    assert OF_TOOL.sum() == 3


def test_nos_keeps_its_free_angle_at_every_target(trials: Trials) -> None:
    planned, scene = trials.planned[0, "nos"], trials.scenes[0]
    spheres = scene.robot_from_ct.apply(scene.phantom.spheres_mm)
    targets = scene.robot_from_ct.apply([one.target_mm for one in scene.phantom.trajectories])

    def free_angle_rad(rotation: np.ndarray, at_mm: np.ndarray) -> float:
        zero, axis = reference_direction(rotation[:, 2], at_mm), rotation[:, 2]
        return float(np.arctan2(np.cross(axis, zero) @ rotation[:, 0], zero @ rotation[:, 0]))

    neutral = planned.localizations.rotations
    assert np.ptp(neutral, axis=0).max() < 1e-9  # one orientation for all spheres
    expected = free_angle_rad(neutral[0], spheres.mean(axis=0))
    for rotation, target in zip(planned.targets.rotations, targets, strict=True):
        assert free_angle_rad(rotation, target) == pytest.approx(expected, abs=1e-9)


def test_the_study_shows_the_fitted_arms_and_what_was_not_fitted_beside_table_4() -> None:
    study = OneExperimentStudy(arms=2)
    (unit,) = study.units()
    found = {table.title: table for table in tables({unit.condition: study.run(unit)})}
    means = found["Means, fitted to table 4"].rows
    assert [row[2] for row in means] == [row.mean_mm for row in CELLS.values()]
    assert all(abs(float(str(row[6]))) < 10.0 for row in means)
    assert len(found["Spread within one arm"].rows) == len(CELLS)
    falls = found["The fall of NOS from three to five spheres"].rows
    assert falls[0][2] == pytest.approx(0.244)
    assert [row[0] for row in falls[1:3]] == ["as drawn", "fitted"]
    assert len(found["What the fit has moved"].rows) == 4
