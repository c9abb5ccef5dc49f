"""tshark, which takes apart the datagrams of a conversation with the left camera."""

from __future__ import annotations

import itertools
import os
import re
import socket
import struct
import tempfile
from collections.abc import Sequence
from pathlib import Path

from captured import Datagram, wireshark_reads, write_capture

GVCP_PORT = 3956
READREG, WRITEREG, READMEM, PACKETRESEND, DISCOVERY = 0x80, 0x82, 0x84, 0x40, 0x02
CCP, SCP, SCPS, SCDA, MCP, MCDA, FIRST_URL = 0x0A00, 0x0D00, 0x0D04, 0x0D18, 0x0B00, 0x0B10, 0x0200
PACKET_BYTES = 1500
LIMIT_S = 10.0


class Conversation:
    """A client of the camera, and all datagrams that passed."""

    def __init__(self) -> None:
        self.camera = (os.environ["LEFT"], GVCP_PORT)
        self.seen: list[Datagram] = []
        self._numbers = itertools.count(1)
        self.control, self.stream = (self._open() for _ in range(2))
        self.ask(DISCOVERY)
        self.write(CCP, 2)
        _, at, size = self._read(FIRST_URL, 512).split(b"\0")[0].decode().split(";")
        words = range(int(at, 16), int(at, 16) + int(size, 16), 4)
        kept, self.seen = self.seen, []
        self._xml = b"".join(self._read(word, 4) for word in words).decode()
        self.seen = kept

    def _open(self) -> socket.socket:
        one = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        one.bind(("127.0.0.1", 0))
        one.settimeout(LIMIT_S)
        return one

    def send(self, command: int, payload: bytes = b"", flags: int = 1) -> None:
        head = struct.pack(">BBHHH", 0x42, flags, command, len(payload), next(self._numbers))
        self.control.sendto(head + payload, self.camera)
        self.seen.append(Datagram(self.control.getsockname(), self.camera, head + payload))

    def receive(self, on: socket.socket) -> bytes:
        content, sender = on.recvfrom(65536)
        self.seen.append(Datagram(sender, on.getsockname(), content))
        return content

    def ask(self, command: int, payload: bytes = b"") -> bytes:
        self.send(command, payload)
        reply = self.receive(self.control)
        assert reply[:2] == b"\0\0"
        return reply[8:]

    def _read(self, address: int, count: int) -> bytes:
        return self.ask(READMEM, struct.pack(">IHH", address, 0, count))[4:]

    def write(self, address: int, value: int) -> None:
        self.ask(WRITEREG, struct.pack(">II", address, value))

    def set(self, feature: str, entry: str | int) -> None:
        """Write a feature at the register that the description gives it."""
        node = re.search(rf'Name="{feature}".*?</(?:Enumeration|Integer|Command)>', self._xml, re.DOTALL)
        assert node is not None
        value = entry
        if isinstance(entry, str):
            found = re.search(rf'EnumEntry Name="{entry}".*?<Value>(\d+)<', node[0], re.DOTALL)
            assert found is not None
            value = int(found[1])
        kept = re.findall(r"<pValue>(\w+)<", node[0])[-1]
        address = re.search(rf'Name="{kept}".*?<Address>(\w+)<', self._xml, re.DOTALL)
        assert address is not None
        self.write(int(address[1], 0), int(value))

    def open_stream(self) -> None:
        self.write(SCP, self.stream.getsockname()[1])
        self.write(SCPS, PACKET_BYTES)
        self.write(SCDA, int.from_bytes(socket.inet_aton("127.0.0.1"), "big"))
        self.set("Width", 64)
        self.set("Height", 48)
        self.set("AcquisitionMode", "SingleFrame")

    def take_image(self) -> None:
        self.set("AcquisitionStart", 1)
        while self.receive(self.stream)[4] & 0x7F != 2:  # the trailer
            pass

    def taken_apart(self, fields: Sequence[str], **ports: int) -> list[dict[str, list[str]]]:
        file = Path(tempfile.mkdtemp()) / "conversation.pcap"
        write_capture(file, self.seen)
        packets = wireshark_reads(file, fields, **{"gvcp": GVCP_PORT, **ports})
        assert not any("_ws.malformed" in packet for packet in packets), "a datagram is malformed"
        return packets


def takes_commands_apart() -> None:
    camera = Conversation()
    camera.ask(READREG, struct.pack(">I", CCP))
    packets = camera.taken_apart(["gvcp.cmd.command", "gvcp.ack"])
    commands = [packet["gvcp.cmd.command"] for packet in packets if "gvcp.cmd.command" in packet]
    assert commands == [[f"0x{code:04x}"] for code in (DISCOVERY, WRITEREG, READMEM, READREG)]
    assert len(packets) == 2 * len(commands)


def takes_an_image_apart() -> None:
    camera = Conversation()
    camera.open_stream()
    camera.seen.clear()
    camera.take_image()
    port = camera.stream.getsockname()[1]
    packets = camera.taken_apart(["gvsp.format", "gvsp.sizex", "gvsp.sizey"], gvsp=port)
    formats = [packet["gvsp.format"][0] for packet in packets if "gvsp.format" in packet]
    assert (formats[0], formats[-1]) == ("0x01", "0x02")
    assert next(packet["gvsp.sizex"] for packet in packets if "gvsp.sizex" in packet) == ["64"]


def takes_a_resend_apart() -> None:
    camera = Conversation()
    camera.open_stream()
    camera.take_image()
    camera.seen.clear()
    camera.send(PACKETRESEND, struct.pack(">HHII", 0, 1, 1, 1), flags=0)
    camera.receive(camera.stream)
    port = camera.stream.getsockname()[1]
    fields = ["gvcp.cmd.resend.firstpacketid", "gvsp.status", "gvsp.packetid24"]
    command, repeated = camera.taken_apart(fields, gvsp=port)
    assert command["gvcp.cmd.resend.firstpacketid"] == ["0x000001"]
    assert repeated["gvsp.packetid24"] == ["1"]


def takes_events_apart() -> None:
    camera = Conversation()
    camera.open_stream()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as messages:
        messages.bind(("127.0.0.1", 0))
        messages.settimeout(LIMIT_S)
        camera.write(MCP, messages.getsockname()[1])
        camera.write(MCDA, int.from_bytes(socket.inet_aton("127.0.0.1"), "big"))
        camera.set("EventSelector", "FrameStart")
        camera.set("EventNotification", "On")
        camera.set("AcquisitionStart", 1)
        camera.seen.clear()
        camera.receive(messages)
        port = messages.getsockname()[1]
        fields = ["gvcp.cmd.command", "gvcp.cmd.event.timestamp"]
        (event,) = camera.taken_apart(fields, gvcp=port)
    assert event["gvcp.cmd.command"] == ["0x00c0"]
    assert event["gvcp.cmd.event.timestamp"]
