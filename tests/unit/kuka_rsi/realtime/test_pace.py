"""The controller's schedule is learnt from its telegrams."""

from __future__ import annotations

import pytest

from drivers.kuka_rsi.realtime.sockets import MOST_MISSING, Pace

CYCLE_NS = 4_000_000
BEGIN_NS = 1_000_000_000


def places(count: int, cycle_ns: float = CYCLE_NS) -> list[int]:
    """An absolute schedule."""
    return [BEGIN_NS + round(cycle_ns * k) for k in range(1, count + 1)]


def test_the_schedule_tolerates_missing_and_late_telegrams() -> None:
    pace = Pace()
    due_ns = places(80)
    for number, due in enumerate(due_ns):
        if number % 5 == 3:
            continue
        pace.arrived(due + 300_000 * (number % 7 == 2))
    assert pace.due_ns - (due_ns[-1] + CYCLE_NS) == pytest.approx(0, abs=75_000)


def test_the_schedule_follows_clock_drift() -> None:
    pace = Pace()
    drifted_ns = places(2000, CYCLE_NS * 1.0002)
    for moment in drifted_ns:
        pace.arrived(moment)
    assert pace.due_ns - (drifted_ns[-1] + CYCLE_NS * 1.0002) == pytest.approx(0, abs=2_000)


@pytest.mark.parametrize("jump_ns", [CYCLE_NS // 2, (MOST_MISSING + 2) * CYCLE_NS])
def test_a_jump_in_the_schedule_discards_the_learnt_one(jump_ns: int) -> None:
    pace = Pace()
    for moment in places(20):
        pace.arrived(moment)
    assert pace.due_ns
    pace.arrived(places(20)[-1] + jump_ns)
    assert pace.due_ns == 0
