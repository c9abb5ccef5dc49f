"""The small parts of the driver: mailbox, histogram, options, faults."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from drivers.kuka_rsi.errors import (
    BadOptions,
    ControllerRestarted,
    DrivesOff,
    HeartbeatLate,
    LinkStopped,
    MotionTripped,
    PathFailed,
    PoseDisagrees,
    ProtectiveStop,
)
from drivers.kuka_rsi.fault_errors import error_of_fault, error_of_refusal
from drivers.kuka_rsi.options import KukaOptions, read_options
from drivers.kuka_rsi.realtime.link_health import EDGES_US, bin_of, percentile_us
from drivers.kuka_rsi.realtime.link_state import (
    NO_STATE,
    Command,
    CommandKind,
    Fault,
    LinkSettings,
    LinkState,
    Orders,
    Phase,
    Record,
    Result,
    StopOrder,
)
from drivers.kuka_rsi.realtime.mailbox import Mailbox, MailboxTorn
from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.motion.limits import working_limits
from ronna_hw.arm.motion.planning import MotionPlan
from ronna_hw.arm.motion.progress import PathLimits
from ronna_hw.arm.pose import Pose
from ronna_hw.wire.kuka_eki import OperationMode

SIX = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)


@pytest.fixture
def mailbox() -> Iterator[Mailbox]:
    fd = os.memfd_create("test")
    Mailbox.initialise(fd)
    box = Mailbox(fd)
    yield box
    box.close()
    os.close(fd)


# Mailbox


def test_a_fresh_mailbox_holds_no_state_and_no_command(mailbox: Mailbox) -> None:
    assert mailbox.read_state() == NO_STATE
    assert mailbox.read_command() is None
    assert mailbox.orders() == Orders(0, 0, 0)


@pytest.mark.parametrize("target", [None, Pose.from_kuka(1, 2, 3, 40, 50, 60)])
def test_a_command_arrives_unchanged(mailbox: Mailbox, target: Pose | None) -> None:
    plan = MotionPlan(SIX, SIX[::-1], PathLimits(0.1, 0.2, 0.3), target, (7.0, 8.0, 9.0))
    command = Command(5, CommandKind.MOVE, plan, 3)
    mailbox.write_command(command)
    assert mailbox.orders().command_number == 5
    assert mailbox.read_command() == command


@pytest.mark.hazard(51)
@pytest.mark.parametrize("reduced", [False, True])
def test_the_limits_of_the_operating_mode_arrive_unchanged(mailbox: Mailbox, reduced: bool) -> None:
    arm = kr6_r900("kr6_r900_sixx")
    limits = working_limits(arm, 0.08).at_reduced_speed(arm) if reduced else working_limits(arm, 0.08)
    mailbox.write_command(Command(5, CommandKind.OPEN, axes_rad=SIX, limits=limits))
    command = mailbox.read_command()
    assert command is not None
    assert command.limits == limits


def test_a_state_arrives_unchanged(mailbox: Mailbox) -> None:
    state = NO_STATE._replace(
        cycles=7,
        IPOC=2**40,
        phase=Phase.RUNNING,
        fault=Fault.MONITOR,
        result=Result.STOPPED,
        degraded=True,
        settled=True,
        stop_number=4,
        foreign=3,
        foreign_host="192.168.10.30",
        measured_rad=SIX,
        violation_kind="jerk",
        violation_axis=6,
        violation_value=-0.5,
        errno=98,
    )
    mailbox.write_state(state)
    assert mailbox.read_state() == state


def test_stop_and_heartbeat_are_read_back_as_orders(mailbox: Mailbox) -> None:
    mailbox.beat(9)
    mailbox.order_stop(2, StopOrder.LINK)
    assert mailbox.orders() == Orders(9, 2 * 8 + 3, 0)


def test_a_torn_block_is_never_read_as_a_state(mailbox: Mailbox) -> None:
    mailbox.write_state(NO_STATE._replace(cycles=0xABCDEF))
    torn = mailbox._memory.find((0xABCDEF).to_bytes(8, "little"))
    mailbox._memory[torn] ^= 0xFF
    with pytest.raises(MailboxTorn):
        mailbox.read_state()


def test_the_recorder_keeps_the_last_cycles_in_order(mailbox: Mailbox) -> None:
    for cycle in range(1, 301):
        mailbox.record(Record(cycle, 4 * cycle, cycle, 10.0, SIX, SIX, cycle % 3))
    kept = mailbox.records()
    assert [r.cycle for r in kept] == list(range(45, 301))
    assert kept[-1] == Record(300, 1200, 300, 10.0, SIX, SIX, 0)


def test_link_settings_survive_a_json_round_trip() -> None:
    settings_given = LinkSettings(
        "h", 1, 2, 3, 4, "v", 4, "S", ("a",), ("b", "c"), ("d",), "s", 0.1, 0.2, 0.3, 5
    )
    assert LinkSettings.from_json(settings_given.to_json()) == settings_given


# Histogram


def test_each_turnaround_falls_between_the_edges_of_its_bin() -> None:
    for value in (0.1, 1.99, 2.0, 2.6, 10.0, 55.5, 4000.0, 1e6):
        k = bin_of(value)
        assert EDGES_US[k] <= value * 1.000001
        assert value < EDGES_US[k + 1] * 1.000001
    assert bin_of(1e12) == len(EDGES_US) - 2


def test_percentiles_lie_in_the_right_bin() -> None:
    counts = [0] * (len(EDGES_US) - 1)
    assert percentile_us(counts, 0.5) == 0.0
    counts[bin_of(10.0)] = 99
    counts[bin_of(1000.0)] = 1
    assert 8.0 < percentile_us(counts, 0.5) < 13.0
    assert 700.0 < percentile_us(counts, 0.999) < 1300.0


# Options


def test_options_have_defaults_and_all_mistakes_are_reported() -> None:
    assert read_options("arm", {}).silence_limit_s == 0.25
    assert read_options("arm", {"variant": "kr6_r900_2"}).variant.value == "kr6_r900_2"
    with pytest.raises(BadOptions, match="options have 3 mistakes") as caught:
        read_options("arm", {"variant": "kr16", "speed_fraction": 0.5, "speed": 1})
    assert caught.value.code == "RSI-013"
    assert caught.value.exit_code == 2
    with pytest.raises(BadOptions, match="silence_limit_s: expected a valid number without quotes"):
        read_options("arm", {"silence_limit_s": "5"})
    with pytest.raises(BadOptions, match="accept_unverified: expected a valid boolean without quotes"):
        read_options("arm", {"accept_unverified": "true"})


# Faults


@pytest.mark.parametrize(
    ("fault", "error", "code"),
    [
        (Fault.HEARTBEAT, HeartbeatLate, "RSI-006"),
        (Fault.PATH, PathFailed, "RSI-016"),
        (Fault.BASE, PoseDisagrees, "RSI-015"),
        (Fault.LINK_STOP, LinkStopped, "RSI-004"),
        (Fault.DRIVES_OFF, DrivesOff, "EKI-009"),
        (Fault.MONITOR, MotionTripped, "RSI-005"),
        (Fault.PROTECTIVE, ProtectiveStop, "RSI-009"),
        (Fault.RESTARTED, ControllerRestarted, "RSI-008"),
    ],
)
def test_a_latched_fault_becomes_its_error(fault: Fault, error: type[Exception], code: str) -> None:
    made = error_of_fault("arm", _with(fault), KukaOptions(), OperationMode.EXT)
    assert made is not None
    with pytest.raises(error) as caught:
        raise made
    assert getattr(caught.value, "code", "") == code


def _with(fault: Fault) -> LinkState:
    return NO_STATE._replace(fault=fault, violation_kind="speed", violation_axis=1)


def test_the_silence_error_names_the_message_that_the_controller_shows() -> None:
    silent = NO_STATE._replace(fault=Fault.SILENCE)
    assert "message 29002" in str(error_of_fault("arm", silent, KukaOptions(), OperationMode.EXT, 29002))
    assert "message" not in str(error_of_fault("arm", silent, KukaOptions(), OperationMode.EXT)).split(";")[0]


def test_every_fault_and_every_refusal_has_a_message() -> None:
    for fault in Fault:
        made = error_of_fault("arm", _with(fault), KukaOptions(), OperationMode.EXT)
        assert (made is None) == (fault is Fault.NONE)
    for result in Result:
        if result.name.startswith("REFUSED"):
            assert "arm" in str(error_of_refusal("arm", NO_STATE._replace(result=result)))
    busy = error_of_refusal("arm", NO_STATE._replace(result=Result.REFUSED_BUSY))
    assert (busy.code, "another motion is running" in str(busy)) == ("RSI-012", True)
