"""Two arms in one collision world: distances agree, and certified paths keep the margin by truth."""

from __future__ import annotations

import numpy as np
import pytest
from coded_errors import raises
from pair_of_arms import LAG_S, PairOfArms

from ronna_hw.arm.clearance.arm_pair import APART_MM, SampledPath, find_approach, require_apart
from ronna_hw.arm.clearance.bodies import segment_distance_mm
from ronna_hw.arm.clearance.live_pair import LivePair
from ronna_hw.arm.errors import ARMS_TOO_CLOSE

FEW, MANY, SCENES = 12, 10_000, 50
ARMS = ("kr6_r900_sixx", "ur5e")


@pytest.mark.parametrize("assistant", ARMS)
def test_the_live_distance_is_the_planned_one(assistant: str) -> None:
    pair = PairOfArms(1, assistant)
    live = LivePair(pair.master, pair.assistant)
    for _ in range(40):
        postures = [pair.posture(arm.bodies.arm) for arm in (pair.master, pair.assistant)]
        planned = pair.world.distance(*postures)
        if planned.distance_mm > 0.0:  # overlaps are only compared by their sign
            assert live.distance(*postures).distance_mm == pytest.approx(planned.distance_mm, abs=1e-3)
        else:
            assert live.distance(*postures).distance_mm < 1e-3


def test_the_watch_finds_every_approach_although_it_does_not_measure_every_time() -> None:
    pair = PairOfArms(4)
    live, measured = LivePair(pair.master, pair.assistant), LivePair(pair.master, pair.assistant)
    here, there = ([pair.posture(arm.bodies.arm) for arm in (pair.master, pair.assistant)] for _ in range(2))
    limit_mm = 300.0
    for share in np.linspace(0.0, 1.0, 200):
        now = [
            tuple(np.add(np.multiply(a, 1.0 - share), np.multiply(b, share)))
            for a, b in zip(here, there, strict=True)
        ]
        near = live.find_near(*now, limit_mm)
        assert (near is not None) == (measured.distance(*now).distance_mm < limit_mm)


def test_an_arm_at_rest_is_as_far_from_the_other_as_the_obstacles_made_of_it() -> None:
    pair = PairOfArms(2)
    moving, resting = (pair.posture(arm.bodies.arm) for arm in (pair.master, pair.assistant))
    obstacles = pair.assistant.as_obstacles(resting, pair.master.base, 12.0)
    axes, radii = pair.master.axes(np.array([moving]))[0], pair.master.radii_mm
    nearest = min(
        segment_distance_mm(tuple(a), tuple(b), *body.capsule[:2]) - radius - body.capsule.radius_mm
        for (a, b), radius in zip(axes.tolist(), radii, strict=True)
        for body in obstacles
    )
    assert nearest == pytest.approx(pair.world.distance(moving, resting).distance_mm - 12.0, abs=1e-3)


def test_an_approach_between_two_postures_is_found() -> None:
    """Both paths are far apart at their ends and pass each other on the way."""
    pair = PairOfArms(3)
    arm = pair.master.bodies.arm
    home = np.array(arm.home_rad)
    ends = [home + np.radians((side, 0.0, 0.0, 0.0, 0.0, 0.0)) for side in (-80.0, 80.0)]
    shares = np.linspace(0.0, 1.0, 100)[:, None]
    swing = SampledPath(pair.master, ends[0] * (1.0 - shares) + ends[1] * shares, 0.02)
    reached_out = home + np.radians((0.0, 60.0, -40.0, 0.0, 0.0, 0.0))
    still = SampledPath.resting(pair.assistant, tuple(reached_out.tolist()), 0.02)
    at_ends = [pair.world.distance(swing.joints_rad[row], still.joints_rad[0]).distance_mm for row in (0, -1)]
    found = find_approach(pair.world, swing, still, LAG_S)
    assert found is not None
    assert found.distance_mm < min(at_ends)
    with raises(ARMS_TOO_CLOSE, match="ARM-011"):
        require_apart(pair.world, swing, still, LAG_S)


def accepted_gaps_mm(pairs: int, scenes: int) -> list[float]:
    """The smallest true distances of random pairs of motions, one or both arms moving, that are allowed."""
    gaps = []
    for number in range(pairs):
        pair = PAIRS.setdefault(number % scenes, PairOfArms(number % scenes, ARMS[number % scenes % 2]))
        first, second = pair.sampled_path(pair.master), pair.sampled_path(pair.assistant)
        lag_s = float(pair.draws.uniform(-LAG_S, LAG_S))
        if find_approach(pair.world, first, second, LAG_S) is not None:  # then one after the other
            lag_s, first = 0.0, SampledPath(first.arm, first.joints_rad[-1:], first.cycle_s)
            if find_approach(pair.world, first, second, 0.0) is not None:
                continue
        gaps.append(pair.least_true_gap_mm(first, second, lag_s))
    return gaps


PAIRS: dict[int, PairOfArms] = {}


def test_allowed_motions_keep_their_distance_by_truth() -> None:
    gaps_mm = accepted_gaps_mm(FEW, 2)
    assert len(gaps_mm) >= FEW // 3
    assert min(gaps_mm) >= APART_MM


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_ten_thousand_pairs_of_motions_keep_their_distance_by_truth() -> None:
    gaps_mm = accepted_gaps_mm(MANY, SCENES)
    assert len(gaps_mm) >= MANY // 3
    assert min(gaps_mm) >= APART_MM
