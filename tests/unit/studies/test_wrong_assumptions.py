"""Studies of wrong assumptions: what is drawn differs as it says, and what a case would see is refused."""

from __future__ import annotations

import math
from collections import Counter, defaultdict

import numpy as np
import pytest

from procedures.registration.rigid_fit import fit_rigid
from studies.accuracy.postures import ARM, TOOL
from studies.accuracy.random_arms import RandomArms
from studies.accuracy.unmodelled_effects import (
    SHIFTS_MM,
    TRANSMISSION_RAD,
    WARM_S,
    DisplacedArms,
    DrawnEffect,
    Effect,
)
from studies.campaign import bounds
from studies.campaign.study import add_up
from studies.correspondence import pairing_misspecified as pairing
from studies.correspondence.outcomes import FALSE, LOST
from studies.correspondence.pairing_misspecified import (
    Assumption,
    MisspecifiedPairingStudy,
    draw_wrong_readings,
    told_factor,
)
from studies.heads import HALF_AXES_MM, NoiseReading, draw_readings, sites_mm
from studies.strategies import distorted_tracker, unmodelled_arm_tables
from studies.strategies.distorted_tracker import Tracker, follow_moves
from studies.strategies.judged_arm import RESIDUAL
from studies.strategies.unmodelled_arm import ARMS, CALIBRATED, GAUGE, UnmodelledArmStudy

JOINTS = np.array([ARM.home_rad])
FLANKS = np.ones((1, 1, 6))
PLACE = (ARM.flange_pose(ARM.home_rad) @ TOOL).translation_mm[None]


def strays_in_head(assumption: Assumption, outliers: int, runs: int) -> np.ndarray:
    """Outliers of the physical set, in the frame of the head: (runs, outliers, 3)."""
    seen = draw_wrong_readings(assumption, 2, 8, outliers, NoiseReading.NORM, runs, np.random.default_rng(3))
    found = []
    for image, physical, pairs in zip(seen.image_mm, seen.physical_mm, seen.pairs, strict=True):
        fit = fit_rigid(physical[pairs[:, 1]], image[pairs[:, 0]])
        strays = np.delete(physical, pairs[:, 1], axis=0)
        found.append(strays @ fit.rotation.T + fit.translation_mm)
    return np.array(found)


def test_without_a_wrong_assumption_the_readings_are_those_of_the_thesis_protocol() -> None:
    right = draw_readings(sites_mm(1), 4, 2, NoiseReading.NORM, 3, np.random.default_rng(4))
    same = draw_wrong_readings(Assumption.HALF, 1, 4, 2, NoiseReading.NORM, 3, np.random.default_rng(4))
    np.testing.assert_array_equal(same.physical_mm, right.physical_mm)
    assert told_factor(Assumption.HALF, NoiseReading.NORM) == 0.5
    assert told_factor(Assumption.NOTHING, NoiseReading.NORM) == 1.0


def test_noise_read_the_other_way_is_too_large_for_norms_and_too_small_for_axes() -> None:
    factors = [told_factor(Assumption.OTHER_READING, noise) for noise in NoiseReading]
    assert math.prod(factors) == pytest.approx(1.0)
    assert told_factor(Assumption.OTHER_READING, NoiseReading.NORM) > 1.0


@pytest.mark.parametrize("noise", NoiseReading)
def test_noise_with_tails_has_the_stated_spread_and_more_far_points(noise: NoiseReading) -> None:
    drawn = pairing.draw_tails((40_000, 3), 0.5, noise, np.random.default_rng(5))
    size = np.linalg.norm(drawn, axis=1) if noise is NoiseReading.NORM else drawn.ravel()
    assert np.sqrt(np.mean(size**2)) == pytest.approx(0.5, rel=0.1)
    assert np.mean(np.abs(size) > 4.0 * 0.5) > 20 * 6.3e-5  # 4 sigmas of a normal distribution


def test_strays_on_the_head_lie_on_it_in_the_room_too() -> None:
    strays = strays_in_head(Assumption.ON_HEAD, 4, 20) / np.array(HALF_AXES_MM[2])
    np.testing.assert_allclose(np.linalg.norm(strays, axis=-1), 1.0, atol=0.05)
    assert strays[..., 2].min() > -0.2
    elsewhere = strays_in_head(Assumption.NOTHING, 4, 20) / np.array(HALF_AXES_MM[2])
    assert np.median(np.abs(np.linalg.norm(elsewhere, axis=-1) - 1.0)) > 0.5


def test_strays_in_a_cluster_are_near_each_other() -> None:
    strays = strays_in_head(Assumption.CLUSTERED, 3, 20)
    apart_mm = np.linalg.norm(strays - np.roll(strays, 1, axis=1), axis=-1)
    assert apart_mm.max() < 2.0 * pairing.CLUSTER_MM + 2.0


def test_the_distortion_has_its_size_and_varies_slowly() -> None:
    places = np.random.default_rng(6).uniform(-500.0, 500.0, (300, 2, 3))
    places[:, 1] = places[:, 0] + (2.0, 0.0, 0.0)
    moved = pairing.distort(places, np.random.default_rng(7)) - places
    assert np.sqrt(np.square(moved).sum(axis=-1).mean()) == pytest.approx(pairing.DISTORTION_MM, rel=0.1)
    assert np.linalg.norm(moved[:, 1] - moved[:, 0], axis=-1).max() < 0.1


def test_sds_wrong_by_a_factor_of_two_lose_pairings_but_make_none_false() -> None:
    # Few: a single false one, as the campaign's 18,000 have, would say nothing about a rate of 1 in 2,000.
    study = MisspecifiedPairingStudy(3, 11, (Assumption.HALF, Assumption.TWICE), (5, 8))
    sums = add_up((unit, study.run(unit)) for unit in study.units())
    outcomes: dict[str, Counter[str]] = {}
    for condition, content in sums.items():
        into = outcomes.setdefault(condition.partition("|")[0], Counter())
        for key, number in content.items():
            into[key.rpartition("|")[2]] += round(number)
    assert outcomes[Assumption.HALF][FALSE] == outcomes[Assumption.TWICE][FALSE] == 0
    assert outcomes[Assumption.HALF][LOST] > outcomes[Assumption.TWICE][LOST]
    pooled, planned, distances = pairing.tables(sums)
    assert {row[0] for row in pooled.rows} == {"told half the sd", "told twice the sd"}
    assert all(row[-1] == "yes" for row in pooled.rows)
    assert len(planned.rows) == len(distances.rows) == 2 * 2 * 2


def shifted(effect: Effect, moved_s: float = 0.0, number: int = 1) -> np.ndarray:
    drawn = DrawnEffect.draw(effect, 8, number)
    arm, time = RandomArms.draw(8, [number]), np.array([moved_s])
    shift_rad = drawn.shift_rad(ARM.chain, JOINTS, PLACE, time)
    wrong = DisplacedArms.at(arm, shift_rad, drawn.shift_mm(time))
    return np.asarray(
        (wrong.tool_points_mm(JOINTS[None], FLANKS) - arm.tool_points_mm(JOINTS[None], FLANKS))[0, 0]
    )


def test_an_arm_with_nothing_amiss_is_the_modelled_arm() -> None:
    np.testing.assert_array_equal(shifted(Effect.NOTHING, 600.0), 0.0)


def test_a_load_lowers_the_tool() -> None:
    for number in range(5):
        assert -2.0 < shifted(Effect.COMPLIANCE, number=number)[2] < 0.0


def test_an_arm_drifts_only_as_it_moves() -> None:
    np.testing.assert_array_equal(shifted(Effect.WARMTH), 0.0)
    early, late = (np.linalg.norm(shifted(Effect.WARMTH, time)) for time in (WARM_S, 20.0 * WARM_S))
    assert early / late == pytest.approx(1.0 - math.exp(-1.0), abs=0.01)


def test_a_gear_errs_by_no_more_than_its_transmission_accuracy() -> None:
    turn = np.zeros((2000, 6))
    turn[:] = np.linspace(0.0, 2.0 * math.pi, len(turn))[:, None]
    for number in range(5):
        drawn = DrawnEffect.draw(Effect.GEARS, 8, number)
        still = np.zeros((len(turn), 3)), np.zeros(len(turn))
        from_peak_to_peak = np.ptp(drawn.shift_rad(ARM.chain, turn, *still), axis=0)
        assert np.all(from_peak_to_peak <= TRANSMISSION_RAD)
        assert np.all(from_peak_to_peak > 0.5 * TRANSMISSION_RAD)


def test_bumps_are_small_as_often_as_large() -> None:
    sizes = [np.linalg.norm(DrawnEffect.draw(Effect.BUMP_AFTER, 8, number).bump_mm) for number in range(200)]
    assert SHIFTS_MM[0] < min(sizes) < max(sizes) < SHIFTS_MM[1]
    assert np.median(sizes) == pytest.approx(math.sqrt(math.prod(SHIFTS_MM)), rel=0.3)


@pytest.mark.parametrize(("tracker", "runs"), [(Tracker.AS_STATED, 60), (Tracker.DISTORTS, 60)])
def test_nine_in_ten_followed_moves_are_within_their_limit(tracker: Tracker, runs: int) -> None:
    sums = follow_moves(tracker, 9, runs)
    assert 0 < sums["used"] < sums["targets"]  # some moves are too large to be followed
    assert sums["inside"] >= 0.88 * sums["used"]
    (row,) = distorted_tracker.tabulate({tracker: sums}).rows
    assert row[0] == tracker


def test_a_distortion_adds_to_the_error_of_a_followed_move() -> None:
    right, wrong = (follow_moves(one, 9, 60) for one in Tracker)
    assert wrong["error"] / wrong["used"] > 1.1 * right["error"] / right["used"]
    assert wrong["inside"] / wrong["used"] < right["inside"] / right["used"]


@pytest.mark.slow
def test_bumps_and_moved_spheres_are_refused_and_right_arms_are_accepted_and_within_their_limit() -> None:
    effects = (Effect.NOTHING, Effect.BUMP_AFTER, Effect.SPHERE_MOVED)
    study = UnmodelledArmStudy(6, 47, effects)  # one arm for each position and strategy
    sums = study.run(study.units()[0])
    total: dict[tuple[str, str], float] = defaultdict(float)
    for key, value in sums.items():
        effect, *_, quantity = key.split("|")
        total[effect, quantity] += value
    assert total[Effect.NOTHING, "used"] == total[Effect.NOTHING, "trials"] == 2 * 6 * 3 * 10
    assert total[Effect.NOTHING, "inside"] >= 0.9 * total[Effect.NOTHING, "used"]
    drawn = [[DrawnEffect.draw(effect, 47, one) for one in range(6)] for effect in effects[1:]]
    shown = sum(float(np.linalg.norm(one.bump_mm)) > 0.1 for one in drawn[0]) / 6.0
    assert total[Effect.BUMP_AFTER, GAUGE] >= 0.9 * shown * total[Effect.BUMP_AFTER, "trials"] > 0.0
    assert total[Effect.SPHERE_MOVED, GAUGE] == 0.0
    moved = sum(float(np.linalg.norm(one.moved_mm)) > 0.6 for one in drawn[1]) / 6.0
    # on the calibrated arms, with four or five spheres; three have little to say
    assert total[Effect.SPHERE_MOVED, RESIDUAL] >= 0.3 * moved * total[Effect.SPHERE_MOVED, "trials"] > 0.0
    coverage, refusals, *_ = unmodelled_arm_tables.tables({ARMS: sums})
    assert {row[0] for row in refusals.rows} == set(effects)
    assert coverage.rows[-1][:3] == (unmodelled_arm_tables.ALL_EFFECTS, CALIBRATED, 6 * 3 * 10 * 3)


def test_coverage_by_groups_is_less_certain_than_by_runs_that_agree_within_a_group() -> None:
    inside, used = np.array([10.0, 10.0, 10.0, 0.0]), np.full(4, 10.0)
    sums = inside.sum(), used.sum(), (inside**2).sum(), (inside * used).sum(), (used**2).sum(), 4.0
    alike = bounds.share_by_group(*sums)
    assert alike is not None
    assert alike.value == 75.0
    assert alike.low is not None
    assert alike.high is not None
    assert alike.high - alike.low > 70.0
    every = bounds.share_by_group(40.0, 40.0, 400.0, 400.0, 400.0, 4.0)
    assert every is not None
    assert every.value == 100.0
    assert every.low == bounds.percent(4, 4).low
    assert bounds.share_by_group(0.0, 0.0, 0.0, 0.0, 0.0, 0.0) is None


def test_an_effect_belongs_to_the_arm_and_not_to_the_order_of_the_run() -> None:
    first, again = (DrawnEffect.draw(Effect.GEARS, 8, 3) for _ in range(2))
    other = DrawnEffect.draw(Effect.GEARS, 8, 4)
    np.testing.assert_array_equal(first.gears_rad, again.gears_rad)
    assert not np.allclose(first.gears_rad, other.gears_rad)
