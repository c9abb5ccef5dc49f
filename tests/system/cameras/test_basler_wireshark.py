"""Wireshark, a third-party tool, dissects what the simulated cameras and the stereo driver send.

It is the stranger for what Aravis 0.8 does not receive: events. Needs Debian's package tshark.
"""

from __future__ import annotations

import shutil
import socket
import struct
from collections.abc import Iterator
from pathlib import Path

import pytest
from captured import Datagram, wireshark_reads, write_capture

from drivers.basler_stereo import gvcp
from ronna_hw.wire.gige_vision import GVCP_PORT, Bootstrap, GvcpCommand, PixelFormat
from sim.basler.message_channel import CameraEvent, MessageChannel
from sim.basler.settings import CameraSettings, EventKind, RampImage
from sim.basler.stream_channel import SentImage, StreamChannel

pytestmark = pytest.mark.skipif(
    shutil.which("tshark") is None,
    reason="proof by Wireshark not made: tshark is missing, install Debian's tshark",
)
LIMIT_S = 30.0
CLIENT, CAMERA = ("127.0.0.1", 40001), ("127.0.0.1", GVCP_PORT)
TICKS = 0x1_2345_6789_ABCD


class Receiver:
    """A socket on which a camera's datagrams arrive."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(LIMIT_S)
        self.address = self.socket.getsockname()

    def next(self) -> Datagram:
        content, sender = self.socket.recvfrom(65536)
        return Datagram(sender, self.address, content)


@pytest.fixture
def receiver() -> Iterator[Receiver]:
    made = Receiver()
    yield made
    made.socket.close()


def test_wireshark_reads_events_and_their_acknowledges(receiver: Receiver, tmp_path: Path) -> None:
    channel = MessageChannel("127.0.0.1", lambda: "127.0.0.1", lambda: 0.0)
    channel.port = receiver.address[1]
    channel.report(CameraEvent(EventKind.EXPOSURE_END, 7, TICKS, struct.pack(">I", 7)))
    channel.report(CameraEvent(EventKind.FRAME_START_OVERTRIGGER, 0, TICKS + 1))
    channel.report(CameraEvent(EventKind.FRAME_START, 0, TICKS + 2))
    seen: list[Datagram] = []
    for _ in range(2):  # what waits goes together as soon as the first is acknowledged
        seen.append(receiver.next())
        command, _, request_id = struct.unpack_from(">HHH", seen[-1].content, 2)
        acknowledge = struct.pack(">HHHH", 0, command + 1, 0, request_id)
        seen.append(Datagram(receiver.address, seen[-1].sender, acknowledge))
        channel._handle_acknowledge(acknowledge)
    channel.close()
    write_capture(tmp_path / "events.pcap", seen)
    item = "gvcp.cmd.event."
    fields = ("gvcp.cmd.command", "gvcp.ack", "gvcp.cmd.req_id", "gvcp.cmd.eventdata.data")
    items = (item + "devicespecificid", item + "blockid", item + "timestamp")
    data, first_answer, others, second_answer = wireshark_reads(
        tmp_path / "events.pcap", (*fields, *items), gvcp=receiver.address[1]
    )
    assert data == {
        "gvcp.cmd.command": ["0x00c2"],
        "gvcp.cmd.req_id": ["0x0001"],
        "gvcp.cmd.eventdata.data": ["00000007"],
        item + "devicespecificid": ["0x9001"],
        item + "blockid": ["0x0007"],
        item + "timestamp": [f"0x{TICKS:016x}"],
    }
    assert others == {
        "gvcp.cmd.command": ["0x00c0"],
        "gvcp.cmd.req_id": ["0x0002"],
        item + "devicespecificid": ["0x9002", "0x9004"],
        item + "blockid": ["0x0000", "0x0000"],
        item + "timestamp": [f"0x{TICKS + 1:016x}", f"0x{TICKS + 2:016x}"],
    }
    assert [answer["gvcp.ack"] for answer in (first_answer, second_answer)] == [["0x00c3"], ["0x00c1"]]


def test_wireshark_reads_an_image_its_resend_and_a_refusal(receiver: Receiver, tmp_path: Path) -> None:
    channel = StreamChannel("127.0.0.1", lambda: "127.0.0.1")
    channel.port = receiver.address[1]
    settings = CameraSettings(width=64, height=48, offset_x=16, offset_y=2, test_image=RampImage.FIXED)
    settings.pixel_format = PixelFormat.MONO12_PACKED
    frame = settings.frame()
    block = channel.block_of(SentImage(frame, bytes(frame.payload_bytes), TICKS))
    assert block is not None
    channel.send(block)
    channel.repeat(1, 2, 2)
    channel.repeat(9, 2, 2)
    seen = [receiver.next() for _ in range(block.trailer_id + 3)]
    channel.close()
    write_capture(tmp_path / "image.pcap", seen)
    geometry = ("gvsp.sizex", "gvsp.sizey", "gvsp.offsetx", "gvsp.offsety")
    fields = ("gvsp.status", "gvsp.blockid16", "gvsp.format", "gvsp.packetid24", "gvsp.timestamp")
    leader, *payloads, trailer, repeated, refused = wireshark_reads(
        tmp_path / "image.pcap", (*fields, "gvsp.pixel", *geometry), gvsp=receiver.address[1]
    )
    assert [leader[name] for name in geometry] == [["64"], ["48"], ["16"], ["2"]]
    assert (leader["gvsp.timestamp"], leader["gvsp.pixel"]) == ([f"0x{TICKS:016x}"], ["0x010c0006"])
    assert [packet["gvsp.packetid24"] for packet in payloads] == [["1"], ["2"], ["3"], ["4"]]
    assert (trailer["gvsp.format"], trailer["gvsp.sizey"]) == (["0x02"], ["48"])
    assert (repeated["gvsp.status"], repeated["gvsp.packetid24"]) == (["0x0100"], ["2"])
    assert (refused["gvsp.status"], refused["gvsp.blockid16"]) == (["0x800c"], ["9"])


def test_wireshark_reads_the_commands_of_the_driver(tmp_path: Path) -> None:
    commands = [
        gvcp.encode(GvcpCommand.DISCOVERY, 1),
        gvcp.encode(GvcpCommand.READREG, 2, gvcp.read_register_command(Bootstrap.CCP)),
        gvcp.encode(GvcpCommand.WRITEREG, 3, gvcp.write_register_command(Bootstrap.SCP, 50000)),
        gvcp.encode(GvcpCommand.READMEM, 4, gvcp.read_memory_command(Bootstrap.FIRST_URL, 512)),
        gvcp.encode(GvcpCommand.WRITEMEM, 5, gvcp.write_memory_command(0x20000, bytes(8))),
        gvcp.encode_resend(6, 300, 5, 9),
        gvcp.encode(GvcpCommand.ACTION, 7, gvcp.action_command(0x524F4E4E, 1, 3)),
    ]
    write_capture(tmp_path / "commands.pcap", [Datagram(CLIENT, CAMERA, command) for command in commands])
    command = "gvcp.cmd."
    read = wireshark_reads(
        tmp_path / "commands.pcap",
        (
            command + "command",
            command + "readreg.bootstrapregister",
            command + "writereg.bootstrapregister",
            command + "readmem.count",
            command + "resend.blockid",
            command + "resend.firstpacketid",
            command + "resend.lastpacketid",
            command + "action.devicekey",
            command + "action.groupmask",
        ),
    )
    assert not any("_ws.malformed" in packet for packet in read)
    codes = [packet[command + "command"] for packet in read]
    assert codes == [[f"0x{code:04x}"] for code in (0x02, 0x80, 0x82, 0x84, 0x86, 0x40, 0x100)]
    assert read[1][command + "readreg.bootstrapregister"] == ["0x00000a00"]
    assert read[2][command + "writereg.bootstrapregister"] == ["0x00000d00"]
    assert read[3][command + "readmem.count"] == ["0x0200"]
    resend = [read[5][f"{command}resend.{name}"] for name in ("blockid", "firstpacketid", "lastpacketid")]
    assert resend == [["0x012c"], ["0x000005"], ["0x000009"]]
    assert read[6][command + "action.devicekey"] == ["0x524f4e4e"]
    assert read[6][command + "action.groupmask"] == ["0x00000003"]
