"""A small GigE Vision camera for the driver's tests, written from the protocol alone. Runs as a process.

    python peer_camera_process.py ADDRESS SERIAL [--model MODEL] [--largest-packet BYTES]

Prints READY, then reads faults from standard input, one per line, and answers each with DONE:
mute, speak, no-frames, drop LIST (packet ids, once per frame), refuse-resend, no-trailer, mute-stream,
let-go, wrong-area, taken, normal, pending MS, count (prints how often it was triggered).
"""

from __future__ import annotations

import argparse
import select
import socket
import struct
import sys
import time

SENSOR = (256, 128)
XML_ADDRESS = 0x100000
BASE = 0x20000

XML = """<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="peer" VendorName="tests" xmlns="http://www.genicam.org/GenApi/Version_1_0">
 <Group Comment="features">
  <Integer Name="Width"><pValue>WidthReg</pValue><Min>16</Min><Max>256</Max><Inc>16</Inc></Integer>
  <Integer Name="Height"><pValue>HeightReg</pValue><Min>1</Min><pMax>SensorHeight</pMax></Integer>
  <Integer Name="OffsetX"><pValue>OffsetXReg</pValue><Min>0</Min><pMax>OffsetXMax</pMax>
   <Inc>16</Inc></Integer>
  <Integer Name="OffsetY"><pValue>OffsetYReg</pValue><Min>0</Min><Inc>1</Inc></Integer>
  <IntSwissKnife Name="OffsetXMax"><pVariable Name="W">Width</pVariable>
   <Formula>256 - W</Formula></IntSwissKnife>
  <Integer Name="SensorWidth"><Value>256</Value></Integer>
  <Integer Name="SensorHeight"><Value>0x80</Value></Integer>
  <Enumeration Name="PixelFormat">
   <EnumEntry Name="Mono8"><Value>0x01080001</Value></EnumEntry>
   <EnumEntry Name="Mono12"><Value>0x01100005</Value></EnumEntry>
   <EnumEntry Name="Mono12Packed"><Value>0x010C0006</Value></EnumEntry>
   <pValue>PixelFormatReg</pValue>
  </Enumeration>
  <IntSwissKnife Name="PayloadSize">
   <pVariable Name="W">Width</pVariable><pVariable Name="H">Height</pVariable>
   <pVariable Name="P">PixelFormat</pVariable>
   <Formula>W * H * ((P &gt;&gt; 16) &amp; 0xFF) / 8</Formula>
  </IntSwissKnife>
  <Enumeration Name="AcquisitionMode">
   <EnumEntry Name="SingleFrame"><Value>0</Value></EnumEntry>
   <EnumEntry Name="Continuous"><Value>2</Value></EnumEntry>
   <pValue>ModeReg</pValue>
  </Enumeration>
  <Command Name="AcquisitionStart"><pValue>StartReg</pValue><CommandValue>1</CommandValue></Command>
  <Command Name="AcquisitionStop"><pValue>StartReg</pValue><CommandValue>0</CommandValue></Command>
  <Enumeration Name="TriggerSelector">
   <EnumEntry Name="AcquisitionStart"><Value>0</Value></EnumEntry>
   <EnumEntry Name="FrameStart"><Value>1</Value></EnumEntry>
   <pValue>TriggerSelectorReg</pValue>
  </Enumeration>
  <Enumeration Name="TriggerMode">
   <EnumEntry Name="Off"><Value>0</Value></EnumEntry><EnumEntry Name="On"><Value>1</Value></EnumEntry>
   <pValue>TriggerModeReg</pValue>
  </Enumeration>
  <Enumeration Name="TriggerSource">
   <EnumEntry Name="Software"><Value>0</Value></EnumEntry><EnumEntry Name="Line1"><Value>1</Value></EnumEntry>
   <pValue>TriggerSourceBits</pValue>
  </Enumeration>
  <Command Name="TriggerSoftware"><pValue>TriggerReg</pValue><CommandValue>1</CommandValue></Command>
  <Float Name="ExposureTimeAbs"><pValue>ExposureConverter</pValue><Min>24.0</Min><Max>1000000.0</Max></Float>
  <Converter Name="ExposureConverter">
   <FormulaTo>FROM * 2</FormulaTo><FormulaFrom>TO / 2</FormulaFrom><pValue>ExposureReg</pValue>
  </Converter>
  <Integer Name="GainRaw"><pValue>GainReg</pValue><Min>36</Min><Max>512</Max></Integer>
  <Integer Name="TLParamsLocked"><pValue>LockedReg</pValue></Integer>
 </Group>
 %s
 <MaskedIntReg Name="TriggerSourceBits"><Address>0x20030</Address><Length>4</Length><LSB>23</LSB><MSB>16</MSB>
  <Endianess>BigEndian</Endianess></MaskedIntReg>
 <IntReg Name="TriggerModeReg"><Address>0x20040</Address><pIndex Offset="4">TriggerSelectorReg</pIndex>
  <Length>4</Length><Endianess>BigEndian</Endianess></IntReg>
</RegisterDescription>
"""

REGISTERS = {
    "WidthReg": 0x00,
    "HeightReg": 0x04,
    "OffsetXReg": 0x08,
    "OffsetYReg": 0x0C,
    "PixelFormatReg": 0x10,
    "ModeReg": 0x14,
    "StartReg": 0x18,
    "TriggerSelectorReg": 0x1C,
    "TriggerReg": 0x20,
    "ExposureReg": 0x24,
    "GainReg": 0x28,
    "LockedReg": 0x2C,
}
TRIGGER_SOURCE, TRIGGER_MODE = 0x30, 0x40


def description() -> bytes:
    lines = [
        f'<IntReg Name="{name}"><Address>0x{BASE + offset:X}</Address><Length>4</Length>'
        "<AccessMode>RW</AccessMode><pPort>Device</pPort><Endianess>BigEndian</Endianess></IntReg>"
        for name, offset in REGISTERS.items()
    ]
    return (XML % "\n ".join(lines)).encode()


class PeerCamera:
    def __init__(self, address: str, serial: str, model: str, largest_packet: int) -> None:
        self.address = address
        self.largest_packet = largest_packet
        self.xml = description()
        self.memory = bytearray(0xA000)
        self.registers = {BASE + offset: 0 for offset in (*REGISTERS.values(), TRIGGER_SOURCE)}
        self.registers |= {BASE + TRIGGER_MODE + 4 * k: 0 for k in range(2)}
        self.set("WidthReg", SENSOR[0])
        self.set("HeightReg", SENSOR[1])
        self.set("PixelFormatReg", 0x01080001)
        self.set("GainReg", 36)
        self.registers[BASE + TRIGGER_SOURCE] = 0xAA00_01BB  # other bits must survive
        self.put(0x0000, struct.pack(">II", 0x00010002, 0x80000001))
        self.put(0x0008, struct.pack(">HHI", 0, 0x0030, 0x53000000 | int(serial[-4:])))
        self.put(0x0024, socket.inet_aton(address))
        for place, text in ((0x48, "Basler"), (0x68, model), (0x88, "1.0"), (0xA8, "none"), (0xD8, serial)):
            self.put(place, text.encode())
        self.put(0x200, f"Local:peer.xml;{XML_ADDRESS:x};{len(self.xml):x}".encode())
        self.put(0x934, struct.pack(">I", 0xDA00006F))
        self.put(0x938, struct.pack(">I", 3000))
        self.put(0x93C, struct.pack(">II", 0, 125_000_000))
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((address, 3956))
        self.owner: tuple[str, int] | None = None
        self.last_owner_s = 0.0
        self.block_id = 0
        self.triggers = 0
        self.sent: dict[int, list[bytes]] = {}
        self.answers: dict[tuple, bytes] = {}
        self.pending_ms = 0
        self.faults: set[str] = set()
        self.dropped: set[int] = set()

    def put(self, address: int, data: bytes) -> None:
        self.memory[address : address + len(data)] = data

    def word(self, address: int) -> int:
        return int(struct.unpack_from(">I", self.memory, address)[0])

    def get(self, name: str) -> int:
        return self.registers[BASE + REGISTERS[name]]

    def set(self, name: str, value: int) -> None:
        self.registers[BASE + REGISTERS[name]] = value

    # -- control ---------------------------------------------------------------------------------------

    def serve(self) -> None:
        while True:
            ready, _, _ = select.select([self.socket, sys.stdin], [], [], 0.05)
            if sys.stdin in ready:
                line = sys.stdin.readline()
                if not line:
                    return
                self.fault(line.split())
            if self.socket in ready:
                datagram, peer = self.socket.recvfrom(65536)
                if "mute" not in self.faults:
                    self.command(datagram, peer)
            elif self.owner and time.monotonic() - self.last_owner_s > self.word(0x938) / 1000:
                self.let_go()  # nothing from it waits to be read

    def command(self, datagram: bytes, peer: tuple[str, int]) -> None:
        if len(datagram) < 8 or datagram[0] != 0x42:
            return
        _, flags, command, length, request_id = struct.unpack_from(">BBHHH", datagram)
        payload = datagram[8 : 8 + length]
        if peer == self.owner:
            self.last_owner_s = time.monotonic()
        if command == 0x40:
            self.resend(payload)
            return
        key = (peer, request_id, command, payload)
        if key not in self.answers:
            if self.pending_ms and command == 0x82:
                self.socket.sendto(
                    struct.pack(">HHHHHH", 0, 0x89, 4, request_id, 0, 2 * self.pending_ms), peer
                )
                time.sleep(self.pending_ms / 1000)
            status, answer = self.act(command, payload, peer)
            code = command + 1
            self.answers = {key: struct.pack(">HHHH", status, code, len(answer), request_id) + answer}
        if flags & 1:
            self.socket.sendto(self.answers[key], peer)

    def act(self, command: int, payload: bytes, peer: tuple[str, int]) -> tuple[int, bytes]:
        if command == 0x02:
            return 0, bytes(self.memory[:248])
        if command == 0x80:
            (address,) = struct.unpack(">I", payload)
            value = self.read(address)
            return (0x8003, b"") if value is None else (0, struct.pack(">I", value))
        if command == 0x82:
            address, value = struct.unpack(">II", payload)
            status = self.write(address, value, peer)
            return status, struct.pack(">HH", 0, 1 if status == 0 else 0)
        if command == 0x84:
            address, _, count = struct.unpack(">IHH", payload)
            source, start = (
                (self.xml, address - XML_ADDRESS) if address >= XML_ADDRESS else (self.memory, address)
            )
            return 0, payload[:4] + bytes(source[start : start + count]).ljust(count, b"\0")
        return 0x8001, b""

    def read(self, address: int) -> int | None:
        if address == 0xA00 and "taken" in self.faults:
            return 2
        return self.registers.get(address, self.word(address) if address < 0xA000 else None)

    def write(self, address: int, value: int, peer: tuple[str, int]) -> int:
        if "taken" in self.faults or (self.owner not in (None, peer)):
            return 0x8006
        if address == 0xA00:
            self.put(0xA00, struct.pack(">I", value))
            self.owner = peer if value else None
            self.last_owner_s = time.monotonic()
            return 0
        if self.owner != peer:
            return 0x8006
        if address == 0xD04 and value & 0x8000_0000:
            self.test_packet(value & 0xFFFF)
            value &= 0x7FFF_FFFF
        if address < 0xA000:
            self.put(address, struct.pack(">I", value))
            return 0
        if address not in self.registers:
            return 0x8003
        name = next((n for n, offset in REGISTERS.items() if BASE + offset == address), "")
        if self.get("LockedReg") and name in ("WidthReg", "HeightReg", "PixelFormatReg"):
            return 0x8006
        if name == "OffsetXReg" and value + self.get("WidthReg") > SENSOR[0]:
            return 0x8002
        self.registers[address] = value
        if name == "StartReg" and value == 1:
            self.block_id = 0
            self.sent.clear()
        if name == "TriggerReg":
            self.trigger()
        return 0

    def let_go(self) -> None:
        self.owner = None
        self.put(0xA00, bytes(4))
        self.put(0xD00, bytes(4))
        self.set("StartReg", 0)

    # -- stream ----------------------------------------------------------------------------------------

    @property
    def destination(self) -> tuple[str, int]:
        return socket.inet_ntoa(bytes(self.memory[0xD18:0xD1C])), self.word(0xD00) & 0xFFFF

    def test_packet(self, size: int) -> None:
        if size <= self.largest_packet:
            self.socket.sendto(bytes(size - 28), self.destination)

    def trigger(self) -> None:
        armed = self.registers[BASE + TRIGGER_MODE + 4] == 1
        software = self.registers[BASE + TRIGGER_SOURCE] == 0xAA00_00BB
        if not (self.get("StartReg") == 1 and armed and software and self.word(0xD00)):
            return
        self.triggers += 1
        if "no-frames" in self.faults:
            return
        self.block_id += 1
        packets = self.packets()
        self.sent = {self.block_id: packets}
        if "mute-stream" in self.faults:
            packets = packets[:2]
        if "no-trailer" in self.faults:
            packets = packets[:-1]
        for number, packet in enumerate(packets):
            if number not in self.dropped:
                self.socket.sendto(packet, self.destination)

    def packets(self) -> list[bytes]:
        width, height = self.get("WidthReg"), self.get("HeightReg")
        x, y, pixel_format = self.get("OffsetXReg"), self.get("OffsetYReg"), self.get("PixelFormatReg")
        data = image_bytes(x, y, width, height, pixel_format, self.block_id)
        if "wrong-area" in self.faults:
            x += 1
        size = (self.word(0xD04) & 0xFFFF) - 36
        pieces = [data[start : start + size] for start in range(0, len(data), size)]
        ticks = time.monotonic_ns() // 8
        leader = struct.pack(">HHQIIIIIHH", 0, 1, ticks, pixel_format, width, height, x, y, 0, 0)
        trailer = struct.pack(">HHI", 0, 1, height)
        contents = [(1, leader), *((3, piece) for piece in pieces), (2, trailer)]
        return [
            struct.pack(">HHI", 0, self.block_id, kind << 24 | number) + content
            for number, (kind, content) in enumerate(contents)
        ]

    def resend(self, payload: bytes) -> None:
        _, block_id, first, last = struct.unpack(">HHII", payload)
        if not self.destination[1]:
            return  # the channel is closed
        for number in range(first, last + 1):
            header = struct.pack(">HI", block_id, number)
            if "refuse-resend" in self.faults or block_id not in self.sent:
                self.socket.sendto(b"\x80\x0c" + header, self.destination)
            else:
                self.socket.sendto(b"\x01\x00" + self.sent[block_id][number][2:], self.destination)

    def fault(self, words: list[str]) -> None:
        name, rest = words[0], words[1:]
        if name == "normal":
            self.faults.clear()
            self.dropped.clear()
            self.pending_ms = 0
        elif name == "drop":
            self.dropped = {int(number) for number in rest}
        elif name == "pending":
            self.pending_ms = int(rest[0])
        elif name == "let-go":
            self.let_go()
        elif name == "count":
            print(self.triggers, end=" ")
        else:
            self.faults.add(name)
        print("DONE", flush=True)


def image_bytes(x: int, y: int, width: int, height: int, pixel_format: int, block_id: int) -> bytes:
    """A pattern that tells sensor position and frame: value = column + 3 row + 7 frame, in 8 or 12 bits."""
    rows = [[(x + c) + 3 * (y + r) + 7 * block_id for c in range(width)] for r in range(height)]
    if pixel_format == 0x01080001:
        return b"".join(bytes(value & 0xFF for value in row) for row in rows)
    values = [16 * value & 0xFFF for row in rows for value in row]
    if pixel_format == 0x01100005:
        return struct.pack(f"<{len(values)}H", *values)
    packed = bytearray()
    for a, b in zip(values[::2], values[1::2], strict=True):
        packed += bytes((a >> 4, (b & 15) << 4 | a & 15, b >> 4))
    return bytes(packed)


if __name__ == "__main__":
    arguments = argparse.ArgumentParser()
    arguments.add_argument("address")
    arguments.add_argument("serial")
    arguments.add_argument("--model", default="acA2000-50gmNIR")
    arguments.add_argument("--largest-packet", type=int, default=9000)
    given = arguments.parse_args()
    camera = PeerCamera(given.address, given.serial, given.model, given.largest_packet)
    print("READY", flush=True)
    camera.serve()
