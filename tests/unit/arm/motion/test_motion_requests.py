"""Random motion requests, interruptions and stops: no commanded set-point breaks a limit or jumps."""

from collections import Counter

import pytest
from motion_requests import CYCLE_S, MODEL, Driven, drive, faults_of

from ronna_hw.arm.clearance.bodies import Bodies
from ronna_hw.arm.clearance.live_watch import LiveWatch
from ronna_hw.arm.monitor import Monitor, monitor_limits
from ronna_hw.arm.motion.set_points import PathMotion

BATCH = 50
PAST_THE_HEAD = (66, 93, 103)  # requests that must be much slower on a part of their way


def _judge(seeds: range, every: int = 1) -> Counter[str]:
    """Drive all; every accepted one is without fault."""
    outcomes: Counter[str] = Counter()
    for seed in seeds:
        driven = drive(seed)
        outcomes[driven.refused or "driven"] += 1
        if not driven.refused:
            assert faults_of(driven, every) == [], f"request {seed}"
            outcomes["stopped"] += driven.rest_predicted_rad is not None
            outcomes["slowed near the head"] += bool(driven.plan and driven.plan.speed_steps)
    return outcomes


@pytest.mark.hazard(21)
@pytest.mark.hazard(24)
@pytest.mark.timeout(180)
@pytest.mark.parametrize("batch", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 10))])
def test_random_requests_break_no_limit_do_not_jump_and_stop_as_predicted(batch: int) -> None:
    outcomes = _judge(range(batch * BATCH, (batch + 1) * BATCH), every=8)
    # The requests are worth something only when all of this happens.
    assert outcomes["driven"] > BATCH // 2
    for kind in ("stopped", "slowed near the head", "ARM-007"):
        assert outcomes[kind] >= BATCH // 20, outcomes


@pytest.mark.soak
@pytest.mark.timeout(3600)
def test_ten_thousand_random_requests_break_no_limit() -> None:
    _judge(range(10_000))


def test_the_first_set_point_is_the_current_position() -> None:
    for seed in range(8):
        driven = drive(seed)
        if driven.plan is not None and not driven.plan.is_standstill:
            motion = PathMotion(driven.plan.path(MODEL), driven.sent[0], driven.plan.limits, CYCLE_S)
            first = motion.prepare().go_rad
            assert max(abs(x - y) for x, y in zip(first, driven.sent[0], strict=True)) < 1e-4


@pytest.mark.hazard(21)
def test_the_monitor_catches_a_generator_that_ignores_the_zone() -> None:
    for driven in map(drive, PAST_THE_HEAD):
        assert _much_slower(driven)
        assert "speed near the head" in _without_steps(driven)


def _much_slower(driven: Driven) -> bool:
    plan = driven.plan
    return plan is not None and any(step.velocity < 0.5 * plan.limits.velocity for step in plan.speed_steps)


def _without_steps(driven: Driven) -> str:
    plan, limits, surroundings = driven.plan, driven.limits, driven.surroundings
    assert plan is not None
    assert limits is not None
    assert surroundings is not None
    start = plan.start_rad
    monitor = Monitor(monitor_limits(MODEL, limits, CYCLE_S, start), start)
    monitor.watch(LiveWatch(Bodies(MODEL, surroundings), CYCLE_S, start))
    motion = PathMotion(plan.path(MODEL), start, plan.limits, CYCLE_S)
    while not motion.is_finished:
        point = motion.prepare().go_rad
        violation = monitor.check(point)
        if violation is not None:
            return str(violation)
        motion.take_go()
        monitor.sent(point)
    return ""
