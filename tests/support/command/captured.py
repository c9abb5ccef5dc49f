"""Datagrams as a capture file, for programs that take captures apart."""

from __future__ import annotations

import json
import socket
import struct
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

RAW_IP = 101  # link type of captures that begin with the IP header
LIMIT_S = 60.0


@dataclass(frozen=True)
class Datagram:
    """One datagram on its way."""

    sender: tuple[str, int]
    receiver: tuple[str, int]
    content: bytes

    def as_packet(self) -> bytes:
        """With IPv4 and UDP headers; without check sums, which nobody looks at."""
        length = 8 + len(self.content)
        addresses = [socket.inet_aton(host) for host, _ in (self.sender, self.receiver)]
        ip = struct.pack(">BBHHHBBH4s4s", 0x45, 0, 20 + length, 0, 0, 64, 17, 0, *addresses)
        return ip + struct.pack(">HHHH", self.sender[1], self.receiver[1], length, 0) + self.content


def write_capture(path: Path, datagrams: Sequence[Datagram]) -> None:
    """A file in the classic format of libpcap."""
    with path.open("wb") as file:
        file.write(struct.pack(">IHHiIII", 0xA1B2C3D4, 2, 4, 0, 0, 65535, RAW_IP))
        for number, datagram in enumerate(datagrams):
            packet = datagram.as_packet()
            file.write(struct.pack(">IIII", number, 0, len(packet), len(packet)) + packet)


def wireshark_reads(path: Path, fields: Sequence[str], **ports: int) -> list[dict[str, list[str]]]:
    """What Wireshark finds in each datagram: values by field. `ports` say which protocol is where."""
    arguments = [part for protocol, port in ports.items() for part in ("-d", f"udp.port=={port},{protocol}")]
    wanted = [part for field in ("_ws.malformed", *fields) for part in ("-e", field)]
    ended = subprocess.run(
        ["tshark", "-n", "-r", str(path), "-T", "json", *arguments, *wanted],
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
    )
    assert ended.returncode == 0, ended.stderr
    packets: list[dict[str, Any]] = json.loads(ended.stdout)
    return [packet["_source"].get("layers", {}) for packet in packets]
