"""The cameras' images come from the cameras only."""

from __future__ import annotations

import contextlib
import socket

from drivers.basler_stereo.stream.receiver import open_stream_socket, probe_arrives
from drivers.basler_stereo.stream.receiver_interface import FrameSlots, OpenStream
from drivers.basler_stereo.stream.receiver_process import _Stream
from ronna_hw.wire import gige_vision as gev

HOST, CAMERA, STRANGER = "127.0.0.1", "127.0.0.2", "127.0.0.3"
PAYLOAD_BYTES, PACKET_BYTES = 1200, 136


def sender(address: str) -> socket.socket:
    made = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    made.bind((address, 0))
    return made


def test_packets_from_another_address_than_the_cameras_are_dropped_and_counted() -> None:
    memory = FrameSlots.allocate(PAYLOAD_BYTES)
    slots = FrameSlots(memory, PAYLOAD_BYTES)
    ours, notes = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    control = sender(HOST)
    with ours, sender(CAMERA) as camera, sender(STRANGER) as stranger:
        control.connect(camera.getsockname())
        images = open_stream_socket(HOST, 1 << 20)
        to = images.getsockname()
        descriptors = [images.detach(), control.detach(), memory, notes.detach()]
        stream = _Stream(OpenStream(1, PAYLOAD_BYTES, PACKET_BYTES, resend=False), descriptors)
        with contextlib.closing(stream):
            for one in (stranger, stranger, camera):
                one.sendto(bytes(100), to)
            buffer = bytearray(1000)
            stream.receive(buffer, memoryview(buffer))
    counters = slots.counters()
    assert (counters.foreign, counters.packets) == (2, 1)


def test_a_test_packet_from_another_address_than_the_cameras_is_none() -> None:
    with open_stream_socket(HOST, 1 << 20) as images, sender(STRANGER) as stranger:
        stranger.sendto(bytes(PACKET_BYTES - gev.IP_UDP_HEADER_BYTES), images.getsockname())
        assert not probe_arrives(images, CAMERA, PACKET_BYTES, 0.0)
        stranger.sendto(bytes(PACKET_BYTES - gev.IP_UDP_HEADER_BYTES), images.getsockname())
        assert probe_arrives(images, STRANGER, PACKET_BYTES, 0.0)
