"""Sessions in which telegrams are lost, late, repeated, or from another sender."""

from __future__ import annotations

import pytest
from responder_stand import (
    fault_of,
    moving,
)

from drivers.kuka_rsi.realtime.link_health import Losses
from drivers.kuka_rsi.realtime.link_state import (
    Fault,
    Orders,
    Result,
)


def test_more_than_three_lost_cycles_degrade_the_link_until_a_clean_second_has_passed() -> None:
    losses = Losses(4)
    ipoc = 0
    for k in range(4):
        assert not losses.degraded
        ipoc += 8
        assert losses.count(ipoc, k) == (1 if k else 0)
    ipoc += 8
    losses.count(ipoc, 4)
    assert losses.degraded
    assert losses.lost == 4
    for _ in range(1000):
        ipoc += 4
        losses.count(ipoc, 4)
    assert not losses.degraded


def test_the_time_stamp_may_wrap_and_repeat_but_not_run_backwards() -> None:
    losses = Losses(4)
    assert losses.count(2**32 - 4, -1) == 0
    assert losses.count(0, -1) == 0
    assert losses.count(0, -1) == -1
    assert losses.count(8, -1) == 1
    assert losses.count(4, -1) == -1  # overtaken on the way
    assert losses.count(12, -1) == 0
    assert losses.count(60_000, -1) is None
    assert losses.count(2**32 - 4000, -1) is None
    for stale in (8, 4, 8):
        assert losses.count(stale, -1) == -1
    assert losses.count(8, -1) is None  # and again and again: that is no accident


@pytest.mark.hazard(18)
def test_overtaken_and_repeated_telegrams_get_no_reply_and_do_not_disturb_the_motion() -> None:
    stand = moving()
    for back in (4, 8, 12):
        stand.ipoc -= back
        assert not stand.cycle()
        stand.ipoc += back - 4
        assert stand.cycle()
    stand.run()
    assert stand.responder.result is Result.DONE
    assert stand.responder.fault is Fault.NONE
    assert stand.smooth()


@pytest.mark.hazard(18)
@pytest.mark.parametrize("stall_ms", [8, 20, 50, 100, 250, 400, 500])
def test_a_motion_continues_smoothly_after_a_host_stall_and_arrives(stall_ms: int) -> None:
    stand = moving()
    assert stand.cycle(lost=stall_ms // 4)
    stand.run()
    assert stand.responder.result is Result.DONE
    assert stand.responder.fault is Fault.NONE
    assert stand.smooth()
    state = stand.responder.state(real_time=False, locked=False)
    assert state.lost == stall_ms // 4


@pytest.mark.hazard(34)
def test_telegrams_of_another_run_get_no_reply_and_latch_a_fault() -> None:
    stand = moving()
    stand.ipoc = 12
    assert not stand.cycle()
    assert stand.responder.fault is Fault.RESTARTED
    assert not stand.cycle()


@pytest.mark.hazard(34)
def test_silence_while_only_another_sender_is_heard_latches_the_restarted_fault() -> None:
    stand = moving()
    orders = Orders(stand.beat, 0, stand.commands)
    stand.responder.senders.count_foreign("10.0.0.3")
    stand.responder.idle(orders, stand.now_ns + 240_000_000)
    assert fault_of(stand) is Fault.NONE
    stand.responder.idle(orders, stand.now_ns + 260_000_000)
    assert fault_of(stand) is Fault.RESTARTED


def test_a_stranger_among_the_telegrams_does_not_disturb_the_motion() -> None:
    stand = moving()
    stand.responder.senders.count_foreign("10.0.0.3")
    stand.run()
    assert stand.responder.result is Result.DONE
    state = stand.responder.state(real_time=False, locked=False)
    assert (state.foreign, state.foreign_host) == (1, "10.0.0.3")
