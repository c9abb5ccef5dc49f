"""The small parts of the driver: mailbox, histogram, EKI framing and state, options, faults."""

from __future__ import annotations

import os
from collections.abc import Iterator
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.kuka_rsi.eki_framing import TelegramScanner, parse_telegram
from drivers.kuka_rsi.eki_state import ControllerState, read_state, require_ready
from drivers.kuka_rsi.errors import (
    BadEkiTelegram,
    BadOptions,
    ControllerNotReady,
    ControllerRestarted,
    DrivesOff,
    HeartbeatLate,
    LinkStopped,
    MotionTripped,
    PathFailed,
    PoseDisagrees,
    ProtectiveStop,
)
from drivers.kuka_rsi.faults import error_of_fault, error_of_refusal
from drivers.kuka_rsi.link_state import (
    NO_STATE,
    Command,
    CommandKind,
    Fault,
    Orders,
    Phase,
    Record,
    Result,
    StopOrder,
)
from drivers.kuka_rsi.mailbox import Mailbox, MailboxTorn
from drivers.kuka_rsi.options import KukaOptions, read_options
from drivers.kuka_rsi.settings import LinkSettings
from drivers.kuka_rsi.turnaround import EDGES_US, bin_of, percentile_us
from ronna_hw.arm.planning import MotionPlan
from ronna_hw.arm.pose import Pose
from ronna_hw.arm.progress import PathLimits

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


def test_a_fresh_mailbox_is_ours_and_says_starting(mailbox: Mailbox) -> None:
    assert mailbox.is_ours
    assert mailbox.read_state() == NO_STATE
    assert mailbox.read_command() is None
    assert mailbox.orders() == Orders(0, 0, 0)


@pytest.mark.parametrize("target", [None, Pose.from_kuka(1, 2, 3, 40, 50, 60)])
def test_a_command_arrives_as_it_was_given(mailbox: Mailbox, target: Pose | None) -> None:
    plan = MotionPlan(SIX, SIX[::-1], PathLimits(0.1, 0.2, 0.3), target, (7.0, 8.0, 9.0))
    command = Command(5, CommandKind.MOVE, plan, 3)
    mailbox.write_command(command)
    assert mailbox.orders().command_number == 5
    assert mailbox.read_command() == command


def test_a_state_arrives_as_it_was_given(mailbox: Mailbox) -> None:
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


def test_stop_and_heartbeat_are_single_words(mailbox: Mailbox) -> None:
    mailbox.beat(9)
    mailbox.order_stop(2, StopOrder.LINK)
    assert mailbox.orders() == Orders(9, 2 * 8 + 3, 0)


def test_a_torn_block_is_never_taken_for_a_state(mailbox: Mailbox) -> None:
    mailbox.write_state(NO_STATE._replace(cycles=1))
    mailbox._memory[1024 + 20] ^= 0xFF
    with pytest.raises(MailboxTorn):
        mailbox.read_state()


def test_the_recorder_keeps_the_last_cycles_in_order(mailbox: Mailbox) -> None:
    for cycle in range(1, 301):
        mailbox.record(Record(cycle, 4 * cycle, cycle, 10.0, SIX, SIX, cycle % 3))
    kept = mailbox.records()
    assert [r.cycle for r in kept] == list(range(45, 301))
    assert kept[-1] == Record(300, 1200, 300, 10.0, SIX, SIX, 0)


def test_settings_survive_their_line_of_json() -> None:
    settings_given = LinkSettings(
        "h", 1, 2, 3, 4, "v", 4, "S", ("a",), ("b", "c"), ("d",), "s", 0.1, 0.2, 0.3, 0.4, 5
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


# EKI framing

STATE = (
    b'<State Id="7" Mode="EXT" Drives="1" EStop="0" Guard="0" ProState="P_ACTIVE" Moving="0" Ov="100" Err="0"'
    b' RSI="2" Tool="1" Base="0" Stopmess="0"><Axis A1="1.5" A2="0" A3="0" A4="0" A5="0" A6="0"></Axis>'
    b'<Pos X="0" Y="0" Z="0" A="0" B="0" C="0" S="2" T="0"></Pos></State>'
)
ACK = b'<Ack Id="3" Cmd="STATUS" Code="0" Text="a &gt; b"></Ack>'


@settings(max_examples=100, deadline=None)
@given(cuts=st.lists(st.integers(0, 2 * len(STATE) + len(ACK)), max_size=8))
def test_telegrams_come_whole_however_the_stream_is_cut(cuts: list[int]) -> None:
    stream = STATE + b"\0\0\r\n" + ACK + STATE
    places = [0, *sorted(cuts), len(stream)]
    scanner = TelegramScanner()
    found = [t for a, b in pairwise(places) for t in scanner.feed(stream[a:b])]
    assert found == [STATE, ACK, STATE]


def test_quoted_brackets_self_closing_elements_and_declarations_do_not_mislead() -> None:
    telegram = b'<State a=">" b="/>"><Axis A1="1"/><Pos/></State>'
    scanner = TelegramScanner()
    assert list(scanner.feed(b'garbage </x><?xml version="1.0"?>' + telegram)) == [telegram]
    assert list(scanner.feed(b"<Ack/>")) == [b"<Ack/>"]


def test_a_declaration_of_a_type_is_refused() -> None:
    with pytest.raises(BadEkiTelegram, match="declaration") as caught:
        list(TelegramScanner().feed(b"<!DOCTYPE State><State></State>"))
    assert caught.value.code == "EKI-004"


def test_a_telegram_without_end_is_refused() -> None:
    with pytest.raises(BadEkiTelegram, match="does not end"):
        list(TelegramScanner().feed(b"<State>" + b"x" * 20_000))


def test_crossed_elements_are_refused() -> None:
    (telegram,) = TelegramScanner().feed(b"<State><Axis></State></Axis>")
    with pytest.raises(BadEkiTelegram, match="well-formed"):
        parse_telegram(telegram)


def _state(**changes: str) -> ControllerState:
    element = parse_telegram(STATE)
    element.attrib.update(changes)
    return read_state(element, 1.0)


def test_a_state_is_read_and_what_it_does_not_say_is_none() -> None:
    state = _state()
    assert state.axes_deg[0] == 1.5
    assert state.context_hash is None
    assert state.holdon is None
    assert _state(HoldOn="0").holdon is False
    assert _state(Cycle="12").cycle_ms == 12


@pytest.mark.parametrize("change", [{"Mode": "FREE"}, {"RSI": "9"}, {"Err": ""}, {"Tool": "x"}])
def test_a_state_with_nonsense_is_refused(change: dict[str, str]) -> None:
    with pytest.raises(BadEkiTelegram):
        _state(**change)


def test_a_state_without_axes_is_refused() -> None:
    with pytest.raises(BadEkiTelegram, match="without its axes"):
        read_state(parse_telegram(b'<State Mode="EXT"></State>'), 0.0)


def test_everything_that_forbids_motion_is_named_at_once() -> None:
    state = _state(Mode="T1", EStop="1", Guard="1", Err="310", Drives="0")
    with pytest.raises(ControllerNotReady) as caught:
        require_ready(state, drives=True)
    for words in ("T1, not EXT", "emergency stop", "guard", "message 310", "drives are off"):
        assert words in str(caught.value)
    require_ready(_state(Drives="0"), drives=False)


# Options


def test_options_have_defaults_and_every_mistake_is_told() -> None:
    assert read_options("arm", {}).silence_limit_s == 0.25
    assert read_options("arm", {"variant": "kr6_r900_2"}).variant.value == "kr6_r900_2"
    with pytest.raises(BadOptions, match="3 wrong options") as caught:
        read_options("arm", {"variant": "kr16", "speed_fraction": 0.5, "speed": 1})
    assert caught.value.code == "RSI-013"
    assert caught.value.exit_code == 2


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
    made = error_of_fault("arm", NO_STATE._replace(fault=fault), KukaOptions())
    assert made is not None
    with pytest.raises(error) as caught:
        raise made
    assert getattr(caught.value, "code", "") == code


def test_silence_names_the_message_that_the_controller_shows() -> None:
    silent = NO_STATE._replace(fault=Fault.SILENCE)
    assert "message 29002" in str(error_of_fault("arm", silent, KukaOptions(), message=29002))
    assert "message" not in str(error_of_fault("arm", silent, KukaOptions())).split(";")[0]


def test_every_fault_and_every_refusal_has_words() -> None:
    for fault in Fault:
        made = error_of_fault("arm", NO_STATE._replace(fault=fault), KukaOptions())
        assert (made is None) == (fault is Fault.NONE)
    for result in Result:
        if result.name.startswith("REFUSED"):
            assert "arm" in str(error_of_refusal("arm", NO_STATE._replace(result=result)))
