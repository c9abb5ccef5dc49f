"""The arm at rest: exact, and the same whatever the timing of the motion."""

from __future__ import annotations

from collections.abc import Callable
from math import cos, pi
from typing import Any

import numpy as np
import pytest

from sim.world.scene.as_built import draw_arm
from sim.world.scene.model import ArmTruth

GOALS = [(5.0, -3.0, 4.0, 10.0, -6.0, 8.0), (-2.0, 2.0, 1.0, -4.0, 3.0, 0.0), (1.0, 2.0, 1.0, 0.0, 3.0, 5.0)]


@pytest.fixture
def truth() -> ArmTruth:
    return draw_arm(np.random.default_rng(3))


def profile(begin: tuple[float, ...], end: tuple[float, ...]) -> list[list[float]]:
    """A smooth move of 300 cycles."""
    shares = [0.5 - 0.5 * cos(pi * n / 300) for n in range(1, 301)]
    return [[a + share * (b - a) for a, b in zip(begin, end, strict=True)] for share in shares]


def poses(bench: Any, idle: list[int], lost: set[int] = frozenset()) -> list[np.ndarray]:  # type: ignore[assignment]
    """True poses at rest after each goal, with `idle` cycles after each and replies lost on the way."""
    bench.enter_movecorr()
    found, place = [], (0.0,) * 6
    for goal, pause in zip(GOALS, idle, strict=True):
        for number, step in enumerate(profile(place, goal)):
            if number in lost:
                bench.miss()
            else:
                bench.answer(step)
        place = goal
        bench.rest(goal)
        for _ in range(pause):
            bench.answer(goal)
        assert bench.published[-1].at_rest
        found.append(bench.published[-1].robot_from_flange)
    return found


def test_the_pose_at_rest_does_not_depend_on_idle_time(
    make_bench: Callable[..., Any], truth: ArmTruth
) -> None:
    first = poses(make_bench(truth=truth), [0, 0, 0])
    second = poses(make_bench(truth=truth), [500, 3, 77])
    for one, other in zip(first, second, strict=True):
        assert np.array_equal(one, other)


def test_lost_replies_during_a_motion_do_not_change_the_pose_at_rest(
    make_bench: Callable[..., Any], truth: ArmTruth
) -> None:
    first = poses(make_bench(truth=truth), [0, 0, 0])
    second = poses(make_bench(truth=truth), [0, 0, 0], lost={1, 30, 31, 150, 298, 299})
    for one, other in zip(first, second, strict=True):
        assert np.array_equal(one, other)


def test_motions_are_counted_by_commands_and_not_by_the_pauses_between_them(
    make_bench: Callable[..., Any], truth: ArmTruth
) -> None:
    for pause in (0, 400):
        bench = make_bench(truth=truth)
        bench.enter_movecorr()
        place = (0.0,) * 6
        for goal in GOALS:
            for step in profile(place, goal):
                bench.answer(step)
            for _ in range(pause):
                bench.answer(goal)
            place = goal
        bench.rest(place)
        assert bench.published[-1].motion_number == len(GOALS)


def test_another_seed_changes_the_pose_at_rest_by_the_repeatability(
    make_bench: Callable[..., Any], truth: ArmTruth
) -> None:
    first = poses(make_bench(truth=truth, seed=1), [0, 0, 0])
    second = poses(make_bench(truth=truth, seed=2), [0, 0, 0])
    distance_mm = [float(np.linalg.norm(a[:3, 3] - b[:3, 3])) for a, b in zip(first, second, strict=True)]
    assert all(0.001 < distance < 0.15 for distance in distance_mm)


def test_the_direction_of_approach_decides_on_which_backlash_flank_the_arm_rests(
    make_bench: Callable[..., Any], perfect_arm: Callable[..., ArmTruth]
) -> None:
    truth = perfect_arm(backlash_rad=(np.radians(0.02),) + (0.0,) * 5)
    seen_mm = []
    for overshoot in (0.0, 4.0):
        bench = make_bench(truth=truth)
        bench.enter_movecorr()
        goal, beyond = (3.0,) + (0.0,) * 5, (3.0 + overshoot,) + (0.0,) * 5
        bench.ramp(beyond)
        bench.ramp(goal, from_deg=beyond)
        bench.rest(goal)
        assert bench.controller.arm.axes_deg[0] == 3.0
        seen_mm.append(bench.published[-1].robot_from_flange[:3, 3])
    # The whole backlash at 445 mm from the axis.
    assert float(np.linalg.norm(seen_mm[0] - seen_mm[1])) == pytest.approx(445.0 * np.radians(0.02), rel=0.01)


def test_the_true_flange_never_jumps(make_bench: Callable[..., Any], truth: ArmTruth) -> None:
    bench = make_bench(truth=truth)
    poses(bench, [0, 5, 0])
    places_mm = np.array([state.robot_from_flange[:3, 3] for state in bench.published])
    assert float(np.linalg.norm(np.diff(places_mm, axis=0), axis=1).max()) < 1.0


def test_nothing_is_published_while_nothing_changes(bench: Any) -> None:
    bench.enter_movecorr()
    before = len(bench.published)
    for _ in range(100):
        bench.answer()
    assert len(bench.published) == before


def test_the_pose_believed_by_the_controller_stays_nominal(
    make_bench: Callable[..., Any], truth: ArmTruth
) -> None:
    bench = make_bench(truth=truth.model_copy(update={"home_deg": (0.0, -90.0, 90.0, 0.0, 90.0, 0.0)}))
    believed = np.array(bench.controller.arm.frame[:3])
    really = bench.published[-1].robot_from_flange[:3, 3]
    assert believed == pytest.approx([445.0, 0.0, 810.0])
    assert 0.1 < float(np.linalg.norm(believed - really)) < 6.0
