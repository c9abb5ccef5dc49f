"""Options of `ronna-sim ur` that are refused."""

from __future__ import annotations

import re
import socket
from ipaddress import IPv4Address

import pytest
from coded_errors import raises

from ronna_hw.host.network import own_address
from sim.errors import EndpointTaken
from sim.universal_robots.command import require_loopback
from sim.universal_robots.connections import Poll, ServiceListener
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.errors import BAD_ADDRESS, UNKNOWN_PARAMETER


@pytest.mark.parametrize("address", ["192.168.0.9", "0.0.0.0", "localhost", "127.0.0.1:30004", "127.0.0.300"])
def test_a_controller_is_simulated_on_loopback_only(address: str) -> None:
    with raises(BAD_ADDRESS) as caught:
        require_loopback(address)
    assert caught.value.code == "URC-002"


def test_an_address_in_use_is_answered_with_the_next_free_one() -> None:
    first, port = own_address(), 30004
    one, second, third = (str(IPv4Address(first) + number) for number in range(3))
    with (
        socket.create_server((one, port)),
        socket.create_server((second, port)),
        pytest.raises(EndpointTaken, match=re.escape(f"of its own: --address {third}.")),
    ):
        ServiceListener(one, port, Poll(), lambda _connection: None)


@pytest.mark.parametrize("assignment", ["power_onn_s=1", "power_on_s=-1", "after_unlock=falls"])
def test_an_unknown_parameter_or_value_is_refused(assignment: str) -> None:
    with raises(UNKNOWN_PARAMETER) as caught:
        ControllerParameters.parse([assignment])
    assert caught.value.code == "URC-001"
