"""A camera's stream takes packets of that camera only; who else sends into it is counted and named."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator

import pytest
from good_inputs import PACKET_BYTES, packets
from waiting import eventually

from drivers.basler_stereo.stream.receiver import ReceiverProcess, StreamReceiver
from drivers.basler_stereo.stream.stream_socket import open_stream_socket, probe_arrives
from ronna_hw.wire import gige_vision as gev

HOST, CAMERA, STRANGER = "127.0.0.1", "127.77.9.1", "127.77.9.2"
PAYLOAD_BYTES = 1200  # as those packets carry
ARRIVES_S = 10.0  # host time, on a busy computer


def sent(address: str, packet: bytes, to: tuple[str, int]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        sender.bind((address, 0))
        sender.sendto(packet, to)


@pytest.fixture
def stream() -> Iterator[socket.socket]:
    with open_stream_socket(HOST, 1 << 20) as opened:
        yield opened


@pytest.fixture
def receiver(stream: socket.socket) -> Iterator[StreamReceiver]:
    process = ReceiverProcess()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        control.connect((CAMERA, gev.GVCP_PORT))
        packet_bytes = PACKET_BYTES + gev.IP_UDP_HEADER_BYTES
        opened = process.receive(stream, control, PAYLOAD_BYTES, packet_bytes, resend=False)
        yield opened
        opened.close()
    process.close()


def test_no_stranger_sends_an_image_for_the_camera(stream: socket.socket, receiver: StreamReceiver) -> None:
    whole, to = packets(), stream.getsockname()
    for at in range(0, len(whole), PACKET_BYTES):
        packet = whole[at : at + PACKET_BYTES]
        sent(STRANGER, packet[:8] + b"\xff" * (len(packet) - 8), to)
        sent(CAMERA, packet, to)
    frame = receiver.take(time.monotonic() + ARRIVES_S)
    assert frame is not None
    assert (bytes(frame.data), frame.missing_packets) == (bytes(PAYLOAD_BYTES), 0)
    eventually(lambda: receiver.counters.packets + receiver.counters.strangers == 28)
    assert receiver.counters.strangers == 14
    assert receiver.counters.stranger_name == STRANGER


@pytest.mark.parametrize(("address", "arrives"), [(CAMERA, True), (STRANGER, False)])
def test_a_test_packet_counts_when_the_camera_sent_it(
    stream: socket.socket, address: str, arrives: bool
) -> None:
    sent(address, bytes(1500 - gev.IP_UDP_HEADER_BYTES), stream.getsockname())
    assert probe_arrives(stream, CAMERA, 1500, 0.1) is arrives
