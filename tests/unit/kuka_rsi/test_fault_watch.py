"""When a report or silence on EKI becomes a fault and a stop: exact limits, without any clock."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, cast

import pytest

from drivers.kuka_rsi.connections import Connections
from drivers.kuka_rsi.eki.telegrams import ControllerState
from drivers.kuka_rsi.errors import ControllerLost, ControllerStopped, LinkProcessDied
from drivers.kuka_rsi.fault_watch import EKI_SILENCE_S, REASON_S, FaultWatch
from drivers.kuka_rsi.options import HEARTBEAT_LIMIT_S, KukaOptions
from ronna_hw.arm.clearance.bodies import Surroundings
from ronna_hw.arm.clearance.live_watch import ViolationKind
from ronna_hw.arm_stream.records import (
    NO_STATE,
    NOTHING_AROUND,
    Fault,
    LinkState,
    Phase,
    RecordedCycle,
    StopOrder,
)
from ronna_hw.devices.lifecycle import Lifecycle, LifecycleGuard
from ronna_hw.errors import RonnaError
from ronna_hw.wire.kuka_eki import OperationMode, RsiState

A_LITTLE_S = 1e-3
MOVING = NO_STATE._replace(phase=Phase.RUNNING, moving=True)
STREAMING_WELL = ControllerState(
    received_s=0.0,
    mode=OperationMode.EXT,
    drives=True,
    emergency_stop=False,
    guard_open=False,
    moving=True,
    error=0,
    rsi=RsiState.MOVECORR,
    tool=1,
    axes_deg=(0.0,) * 6,
)


@dataclass
class Link:
    """Real-time process as the driver sees it."""

    state: LinkState = MOVING
    alive: bool = True
    stalled_s: float = 0.0
    surroundings: Surroundings = NOTHING_AROUND
    stops: list[StopOrder] = field(default_factory=list)

    def stop(self, kind: StopOrder) -> None:
        self.stops.append(kind)

    def recorded_cycles(self) -> tuple[RecordedCycle, ...]:
        return ()

    def death_error(self) -> RonnaError:
        return LinkProcessDied("the real-time process ended: killed by SIGKILL")


@dataclass
class Eki:
    """EKI session as the driver sees it."""

    where: str = "tcp://127.0.0.1:54602"
    silent_s: float = 0.0
    failure: RonnaError | None = None
    latest: ControllerState | None = None
    answer: ControllerState | None = None
    asked: int = 0

    def request_state(self) -> int:
        self.asked += 1
        return self.asked

    def find_reply(self, number: int) -> ControllerState | None:
        assert number == self.asked
        return self.answer

    def await_reply(self, number: int, timeout_s: float) -> ControllerState | None:
        assert 0.0 < timeout_s <= REASON_S
        return self.find_reply(number)


class Watched:
    def __init__(self, **options: Any) -> None:
        self.link, self.eki = Link(), Eki()
        connections = type(
            "OpenConnections", (), {"open_eki": self.eki, "open_link": self.link, "link": self.link}
        )
        self.guard = LifecycleGuard("robot.master")
        for state in (Lifecycle.CONNECTED, Lifecycle.CONFIGURED, Lifecycle.ACTIVE):
            self.guard.enter(state)
        self.watch = FaultWatch(
            "robot.master", self.guard, cast("Connections", connections), KukaOptions.model_validate(options)
        )

    @property
    def outcome(self) -> tuple[str, list[StopOrder]]:
        """The code of the fault, and the stops that were ordered."""
        return (self.guard.fault.code if self.guard.fault else "", self.link.stops)


@pytest.mark.hazard(4)
@pytest.mark.parametrize(
    ("options", "limit_s"), [({}, EKI_SILENCE_S), ({"silence_limit_s": 5.0}, 5.0)], ids=["usual", "patient"]
)
def test_eki_silence_is_tolerated_up_to_its_limit_and_no_longer(
    options: dict[str, float], limit_s: float
) -> None:
    _tolerated_up_to(limit_s, Watched(**options), "eki", "silent_s", ("EKI-003", [StopOrder.PROTECTIVE]))


@pytest.mark.hazard(4)
@pytest.mark.parametrize(
    ("options", "limit_s"),
    [({}, HEARTBEAT_LIMIT_S), ({"heartbeat_limit_s": 0.2}, 0.25), ({"silence_limit_s": 3.0}, 3.0)],
    ids=["the heartbeat's", "the silence's", "the silence's, when patient"],
)
def test_a_stalled_real_time_process_is_tolerated_up_to_its_limit(
    options: dict[str, float], limit_s: float
) -> None:
    # Nobody is there to carry a stop out: the controller's Timeout does.
    _tolerated_up_to(limit_s, Watched(**options), "link", "stalled_s", ("RSI-020", []))


def _tolerated_up_to(limit_s: float, watched: Watched, end: str, name: str, outcome: Any) -> None:
    setattr(getattr(watched, end), name, limit_s)
    watched.watch.on_silence()  # from the reader of the EKI channel: nobody has asked
    assert watched.outcome == ("", [])
    setattr(getattr(watched, end), name, limit_s + A_LITTLE_S)
    watched.watch.on_silence()
    assert watched.outcome == outcome


@pytest.mark.hazard(4)
@pytest.mark.parametrize(
    "change",
    [
        {"emergency_stop": True},
        {"guard_open": True},
        {"mode": OperationMode.T1},
        {"drives": False},
        {"error": 1},
    ],
    ids=lambda change: next(iter(change)),
)
def test_a_state_that_forbids_motion_latches_a_fault_and_orders_the_stop_once(change: dict[str, Any]) -> None:
    watched = Watched()
    watched.watch.on_state(STREAMING_WELL)
    assert watched.outcome == ("", [])
    watched.watch.on_state(_changed(**change))
    assert watched.outcome == ("EKI-010", [StopOrder.PROTECTIVE])
    watched.watch.on_state(_changed(**change))
    assert watched.outcome == ("EKI-010", [StopOrder.PROTECTIVE])  # latched, and ordered once


def test_a_stop_names_a_foreign_sender_of_telegrams() -> None:
    watched = Watched()
    watched.link.state = MOVING._replace(foreign=101, foreign_host="192.168.1.7")
    watched.watch.on_state(_changed(error=29002))
    assert (
        "29002 is not acknowledged; note: 101 telegrams came from another sender, the last from 192.168.1.7"
        in str(watched.guard.fault)
    )


@pytest.mark.hazard(4)
def test_a_lost_eki_channel_orders_the_stop() -> None:
    watched = Watched()
    watched.watch.on_loss(ControllerLost("tcp://127.0.0.1:54602 closed the connection"))
    assert watched.outcome == ("EKI-002", [StopOrder.PROTECTIVE])


def _changed(**change: Any) -> ControllerState:
    return replace(STREAMING_WELL, **change)


@pytest.mark.hazard(4)
def test_a_link_process_that_dies_while_the_arm_is_parked_is_a_fault_at_once() -> None:
    watched = Watched()
    watched.guard.enter(Lifecycle.CONFIGURED)
    watched.watch.on_state(STREAMING_WELL)
    assert watched.guard.fault is None
    watched.link.alive = False
    watched.watch.on_state(STREAMING_WELL)
    assert isinstance(watched.guard.fault, LinkProcessDied)


NO_LONGER_FOLLOWS = MOVING._replace(
    phase=Phase.FAULT, fault=Fault.MONITOR, violation_kind=ViolationKind.FOLLOWING_ERROR
)


@pytest.mark.hazard(38)
@pytest.mark.parametrize(
    ("change", "code"),
    [({}, "RSI-005"), ({"emergency_stop": True}, "EKI-010"), ({"drives": False}, "EKI-010")],
    ids=["none", "emergency stop", "drives off"],
)
def test_a_following_error_is_attributed_to_the_controllers_next_state(
    change: dict[str, Any], code: str
) -> None:
    watched = Watched()
    watched.eki.latest = STREAMING_WELL  # sent before
    watched.link.state = NO_LONGER_FOLLOWS
    watched.watch.check()
    assert watched.outcome[0] == ""
    watched.eki.answer = _changed(**change)
    watched.watch.on_state(watched.eki.answer)
    assert watched.outcome[0] == code
    assert watched.eki.asked == 1


@pytest.mark.hazard(38)
def test_a_call_waits_for_the_cause_of_a_following_error() -> None:
    watched = Watched()
    watched.link.state = NO_LONGER_FOLLOWS
    watched.watch.check()
    watched.eki.answer = _changed(guard_open=True)
    with pytest.raises(ControllerStopped, match="guard is open"):
        watched.watch.raise_any()


@pytest.mark.hazard(38)
def test_the_wait_for_the_cause_of_a_following_error_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    watched, now_s = Watched(), [100.0]
    monkeypatch.setattr("drivers.kuka_rsi.fault_watch.time.monotonic", lambda: now_s[0])
    watched.link.state = NO_LONGER_FOLLOWS
    watched.watch.check()
    now_s[0] += REASON_S
    watched.watch.check()
    assert watched.outcome[0] == ""
    now_s[0] += A_LITTLE_S
    watched.watch.check()
    assert watched.outcome[0] == "RSI-005"
