"""The doctor says beforehand when the robot's driver could not listen."""

from __future__ import annotations

import socket

from procedures.cli.stream_port import look_at_stream_port
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.free_port import free_udp_port


def test_a_free_port_is_well_and_left_free() -> None:
    endpoint = parse_endpoint(f"udp://127.0.0.1:{free_udp_port()}")
    assert look_at_stream_port(endpoint).well
    assert look_at_stream_port(endpoint).well


def test_a_taken_port_is_told_with_the_command_that_names_who_has_it() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as other:
        other.bind(("127.0.0.1", 0))
        port = other.getsockname()[1]
        seen = look_at_stream_port(parse_endpoint(f"udp://127.0.0.1:{port}"))
    assert not seen.well
    assert "another program" in seen.seen
    assert f"ss -ulnp 'sport = {port}'" in seen.advice


def test_an_address_of_another_subnet_is_told_as_not_of_this_computer() -> None:
    seen = look_at_stream_port(
        parse_endpoint(f"udp://192.0.2.1:{free_udp_port()}")
    )  # for documents: RFC 5737
    assert not seen.well
    assert "192.0.2.1 is no address of this computer" in seen.seen
    assert "Ethernet file" in seen.advice
