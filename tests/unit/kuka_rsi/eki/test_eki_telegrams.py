"""Input on the EKI channel: telegrams are found in the stream, and a State is read or refused."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from itertools import pairwise

import pytest
from coded_errors import raises
from fake_controller import FakeController
from hypothesis import given, settings
from hypothesis import strategies as st
from waiting import HANG_LIMIT_S, eventually

from drivers.kuka_rsi.eki.client import EkiClient
from drivers.kuka_rsi.eki.telegrams import (
    LONGEST_TELEGRAM,
    ControllerState,
    TelegramScanner,
    parse_telegram,
    read_state,
    require_ready,
)
from drivers.kuka_rsi.errors import BAD_EKI_TELEGRAM, CONTROLLER_NOT_READY
from ronna_hw.wire.kuka_eki import AckCode, CommandName

STATE = (
    b'<State Id="7" Mode="EXT" Drives="1" EStop="0" Guard="0" ProState="P_ACTIVE" Moving="0" Ov="100" Err="0"'
    b' RSI="2" Tool="1" Base="0" Stopmess="0"><Axis A1="1.5" A2="0" A3="0" A4="0" A5="0" A6="0"></Axis>'
    b'<Pos X="0" Y="0" Z="0" A="0" B="0" C="0" S="2" T="0"></Pos></State>'
)
ACK = b'<Ack Id="3" Cmd="STATUS" Code="0" Text="a &gt; b"></Ack>'


@settings(max_examples=100, deadline=None)
@given(cuts=st.lists(st.integers(0, 2 * len(STATE) + len(ACK)), max_size=8))
def test_telegrams_are_reassembled_however_the_stream_is_split(cuts: list[int]) -> None:
    stream = STATE + b"\0\0\r\n" + ACK + STATE
    places = [0, *sorted(cuts), len(stream)]
    scanner = TelegramScanner()
    found = [t for a, b in pairwise(places) for t in scanner.feed(stream[a:b])]
    assert found == [STATE, ACK, STATE]


def test_quoted_brackets_self_closing_elements_and_declarations_are_handled() -> None:
    telegram = b'<State a=">" b="/>"><Axis A1="1"/><Pos/></State>'
    scanner = TelegramScanner()
    assert list(scanner.feed(b'garbage </x><?xml version="1.0"?>' + telegram)) == [telegram]
    assert list(scanner.feed(b"<Ack/>")) == [b"<Ack/>"]


def test_a_doctype_declaration_is_refused() -> None:
    with raises(BAD_EKI_TELEGRAM, match="declaration") as caught:
        list(TelegramScanner().feed(b"<!DOCTYPE State><State></State>"))
    assert caught.value.code == "EKI-004"


def test_a_telegram_without_an_end_is_refused() -> None:
    with raises(BAD_EKI_TELEGRAM, match="without end tag"):
        list(TelegramScanner().feed(b"<State>" + b"x" * 20_000))


@pytest.mark.parametrize("following", [STATE, ACK], ids=["State", "Ack"])
def test_a_truncated_telegram_is_reported_before_the_end_of_the_next_one(following: bytes) -> None:
    for kept in range(1, len(STATE)):
        scanner = TelegramScanner()
        assert list(scanner.feed(STATE[:kept])) == []
        with raises(BAD_EKI_TELEGRAM, match="is truncated"):
            list(scanner.feed(following[:-1]))


def test_a_telegram_may_fill_the_buffer_of_a_channel() -> None:
    telegram = b"<State>" + b"x" * (LONGEST_TELEGRAM - len(b"<State></State>")) + b"</State>"
    assert list(TelegramScanner().feed(telegram)) == [telegram]


def test_wrongly_nested_elements_are_refused() -> None:
    (telegram,) = TelegramScanner().feed(b"<State><Axis></State></Axis>")
    with raises(BAD_EKI_TELEGRAM, match="well-formed"):
        parse_telegram(telegram)


def _state(**changes: str) -> ControllerState:
    element = parse_telegram(STATE)
    element.attrib.update(changes)
    return read_state(element, 1.0)


def test_a_state_is_read_and_absent_facts_are_none() -> None:
    state = _state()
    assert state.axes_deg[0] == 1.5
    assert state.context_hash is None
    assert state.holdon is None
    assert _state(HoldOn="0").holdon is False
    assert _state(Cycle="12").cycle_ms == 12


@pytest.mark.parametrize(
    "change", [{"Mode": "FREE"}, {"RSI": "9"}, {"Err": ""}, {"Tool": "x"}, {"EStop": "nan"}, {"Drives": "on"}]
)
def test_a_state_with_invalid_values_is_refused(change: dict[str, str]) -> None:
    with raises(BAD_EKI_TELEGRAM):
        _state(**change)


@pytest.mark.parametrize("angle", ["nan", "inf", "", "1,5"])
def test_an_axis_that_is_not_a_number_is_refused(angle: str) -> None:
    with raises(BAD_EKI_TELEGRAM, match="cannot be read"):
        read_state(parse_telegram(STATE.replace(b'A1="1.5"', f'A1="{angle}"'.encode())), 0.0)


def test_a_state_without_axes_is_refused() -> None:
    with raises(BAD_EKI_TELEGRAM, match="without axes"):
        read_state(parse_telegram(b'<State Mode="EXT"></State>'), 0.0)


def test_everything_that_forbids_motion_is_reported_at_once() -> None:
    state = _state(Mode="T1", EStop="1", Guard="1", Err="310", Drives="0")
    with raises(CONTROLLER_NOT_READY) as caught:
        require_ready(state, drives=True)
    for words in ("T1, not EXT", "emergency stop", "guard", "message 310", "drives are off"):
        assert words in str(caught.value)
    require_ready(_state(Drives="0"), drives=False)


@pytest.fixture
def client(controller: FakeController) -> Iterator[EkiClient]:
    with closing(EkiClient("127.0.0.1", controller.eki_port, HANG_LIMIT_S)) as made:
        yield made


def leave(controller: FakeController, client: EkiClient, *telegrams: str) -> None:
    """Send what an earlier connection has left, and return once the client has taken it."""
    eventually(lambda: client.latest is not None)
    controller.send_raw("".join(telegrams).encode())
    controller.tell(Tool="7")
    eventually(lambda: client.latest is not None and client.latest.tool == 7)


def test_an_acknowledgement_that_came_before_its_command_does_not_answer_it(
    controller: FakeController, client: EkiClient
) -> None:
    following = client.request_state() + 1
    leave(controller, client, f'<Ack Id="{following}" Cmd="DRIVES" Code="0" Text=""></Ack>')
    controller.ack_codes["DRIVES"] = AckCode.REFUSED.value
    assert client.command(CommandName.DRIVES, HANG_LIMIT_S, On=1).code is AckCode.REFUSED


def test_a_state_that_came_before_its_request_does_not_answer_it(
    controller: FakeController, client: EkiClient
) -> None:
    following = client.request_state() + 1
    leave(controller, client, controller.state(following).decode())
    controller.facts["EStop"] = "1"
    assert client.status(HANG_LIMIT_S).emergency_stop


def test_the_acknowledgement_of_another_command_is_a_mistake_of_the_controller(
    controller: FakeController, client: EkiClient
) -> None:
    following = client.request_state() + 1
    controller.mute_commands.add("RSI_STOP")
    sent = client._send(CommandName.RSI_STOP, {})
    assert sent == following
    controller.send_raw(f'<Ack Id="{sent}" Cmd="DRIVES" Code="0" Text=""></Ack>'.encode())
    with raises(BAD_EKI_TELEGRAM, match="DRIVES"):
        client.command(CommandName.ACK_ERRORS, HANG_LIMIT_S)


def test_two_connections_do_not_count_alike(controller: FakeController) -> None:
    # What the controller still sends for one of them is not for the next.
    numbers = set()
    for _ in range(3):
        with closing(EkiClient("127.0.0.1", controller.eki_port, HANG_LIMIT_S)) as client:
            numbers.add(client.request_state())
    assert len(numbers) == 3
