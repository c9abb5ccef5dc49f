"""When silence, loss or the end of a process becomes a fault and a stop of either arm, to exact limits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from watched_stream import Watched, watched_kuka, watched_ur

from ronna_hw.arm_stream.options import HEARTBEAT_LIMIT_S
from ronna_hw.arm_stream.records import StopOrder
from ronna_hw.arm_stream.watch import CONTROL_SILENCE_S
from ronna_hw.devices.lifecycle import Lifecycle
from ronna_hw.errors import RonnaError

A_LITTLE_S = 1e-3
Make = Callable[..., Watched]
pytestmark = pytest.mark.hazard(4)


def on_either_arm(kuka: str, ur: str) -> Any:
    arms = [pytest.param(watched_kuka, kuka, id="kuka"), pytest.param(watched_ur, ur, id="ur")]
    return pytest.mark.parametrize(("make", "code"), arms)


@on_either_arm("EKI-003", "URD-015")
@pytest.mark.parametrize(
    ("options", "limit_s"),
    [({}, CONTROL_SILENCE_S), ({"silence_limit_s": 5.0}, 5.0)],
    ids=["usual", "patient"],
)
def test_silence_of_the_controller_is_tolerated_up_to_its_limit_and_no_longer(
    make: Make, code: str, options: dict[str, float], limit_s: float
) -> None:
    _tolerated_up_to(limit_s, make(**options), "control", "silent_s", (code, [StopOrder.PROTECTIVE]))


@on_either_arm("RSI-020", "URD-025")
@pytest.mark.parametrize(
    ("options", "limit_s"),
    [({}, HEARTBEAT_LIMIT_S), ({"heartbeat_limit_s": 0.2}, 0.25), ({"silence_limit_s": 3.0}, 3.0)],
    ids=["the heartbeat's", "the silence's", "the silence's, when patient"],
)
def test_a_stalled_real_time_process_is_tolerated_up_to_its_limit(
    make: Make, code: str, options: dict[str, float], limit_s: float
) -> None:
    # Nobody is there to carry a stop out: the controller does.
    _tolerated_up_to(limit_s, make(**options), "link", "stalled_s", (code, []))


def _tolerated_up_to(limit_s: float, watched: Watched, end: str, name: str, outcome: Any) -> None:
    setattr(getattr(watched, end), name, limit_s)
    watched.watch.on_silence()  # from the reader of the channel: nobody has asked
    assert watched.outcome == ("", [])
    setattr(getattr(watched, end), name, limit_s + A_LITTLE_S)
    watched.watch.on_silence()
    assert watched.outcome == outcome


@on_either_arm("EKI-002", "URD-014")
def test_a_lost_control_channel_orders_the_stop(make: Make, code: str) -> None:
    watched = make()
    watched.watch.on_loss(_lost(watched))
    assert watched.outcome == (code, [StopOrder.PROTECTIVE])


@on_either_arm("RSI-007", "URD-024")
def test_a_real_time_process_that_dies_while_the_arm_is_parked_is_a_fault_at_once(
    make: Make, code: str
) -> None:
    watched = make()
    watched.guard.enter(Lifecycle.CONFIGURED)
    watched.watch.on_silence()
    assert watched.guard.fault is None
    watched.link.alive = False
    watched.watch.on_silence()
    assert watched.outcome == (code, [])


@on_either_arm("EKI-002", "URD-014")
def test_a_control_channel_that_breaks_while_the_arm_is_parked_is_a_fault(make: Make, code: str) -> None:
    watched = make()
    watched.guard.enter(Lifecycle.CONFIGURED)
    watched.control.failure = _lost(watched)
    watched.watch.on_silence()
    assert watched.outcome == (code, [])


@on_either_arm("EKI-002", "URD-014")
def test_a_fault_is_raised_to_the_next_call_and_then_only_where_any_counts(make: Make, code: str) -> None:
    watched = make()
    watched.watch.on_loss(_lost(watched))
    with pytest.raises(RonnaError, match=code):
        watched.watch.raise_new()
    watched.watch.raise_new()
    with pytest.raises(RonnaError, match=code):
        watched.watch.raise_any()


def _lost(watched: Watched) -> RonnaError:
    return watched.connections.faults.errors.lost("tcp://127.0.0.1:1 closed the connection")
