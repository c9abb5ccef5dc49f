"""Replies on EKI: each belongs to one command of this connection, by its number and its name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import pytest
from coded_errors import raises
from fake_controller import FakeController
from waiting import HANG_LIMIT_S, eventually

from drivers.kuka_rsi.eki.client import EkiClient
from drivers.kuka_rsi.errors import BAD_EKI_TELEGRAM
from ronna_hw.wire.kuka_eki import AckCode, CommandName


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
