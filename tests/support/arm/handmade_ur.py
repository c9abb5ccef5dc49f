"""Hand-made Universal Robots controller: bytes and lines as the vendor's guides describe them, written out.

It shares no code with the driver or the simulator. It answers what a start asks, and sends no stream.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
from collections.abc import Callable
from typing import Any

UR5E_THETA = (0.0,) * 6
UR5E_A = (0.0, -0.425, -0.3922, 0.0, 0.0, 0.0)
UR5E_D = (0.1625, 0.0, 0.0, 0.1333, 0.0997, 0.0996)
UR5E_ALPHA = (1.570796327, 0.0, 0.0, 1.570796327, -1.570796327, 0.0)
HOME = (0.0, -1.5, -1.5, -1.5, 1.5, -1.5)
OUTPUT_TYPES = (
    "DOUBLE,VECTOR6D,VECTOR6D,DOUBLE,DOUBLE,INT32,INT32,UINT32,INT32,INT32,INT32,VECTOR6D,VECTOR6D,VECTOR6D"
)
INPUT_TYPES = "INT32,INT32,INT32,DOUBLE,DOUBLE,DOUBLE,DOUBLE,DOUBLE,DOUBLE"


def rtde(kind: str, payload: bytes) -> bytes:
    return struct.pack(">HB", 3 + len(payload), ord(kind)) + payload


def part(kind: int, body: bytes) -> bytes:
    return struct.pack(">IB", 5 + len(body), kind) + body


def robot_state(
    speed_fraction: float = 1.0,
    digital_inputs: int = 0,
    checksums: tuple[int, ...] = (1, 2, 3, 4, 5, 6),
    theta: tuple[float, ...] = UR5E_THETA,
    a: tuple[float, ...] = UR5E_A,
    safety_mode: int = 1,
    timestamp_us: int = 1_000_000,
) -> bytes:
    """Return a package of the primary interface with the parts of PolyScope 5."""
    stops = (True, True, True, False, False, False, False)  # connected, enabled, powered; nothing else
    mode = struct.pack(">Q7?BBdddB", timestamp_us, *stops, 7, 0, speed_fraction, 1.0, 1.0, 0)
    joints = b"".join(struct.pack(">3d4fB", angle, angle, 0.0, 0.1, 48.0, 30.0, 31.0, 253) for angle in HOME)
    board = struct.pack(
        ">iibbddbbddffffB", digital_inputs, 0, 0, 0, 0.0, 0.0, 0, 0, 0.0, 0.0, 30.0, 48.0, 0.5, 0.1,
        safety_mode,
    )  # fmt: skip
    kinematics = struct.pack(">6I24dI", *checksums, *theta, *a, *UR5E_D, *UR5E_ALPHA, 2)
    body = (
        part(0, mode) + part(1, joints) + part(3, board + bytes(20)) + part(5, kinematics) + part(9, bytes(7))
    )
    return struct.pack(">iB", 5 + len(body), 16) + body


class HandmadeController:
    """Three servers on ports of their own; change its attributes to make it answer differently."""

    def __init__(self, host: str = "127.0.0.1") -> None:
        self._host = host
        self.answers: dict[str, str | None] = {
            "get robot model": "UR5",
            "get serial number": "20265500001",
            "is in remote control": "true",
            "robotmode": "Robotmode: RUNNING",
            "safetymode": "Safetymode: NORMAL",
            "running": "Program running: false",
            "power on": "Powering on",
            "brake release": "Brake releasing",
            "stop": "Stopped",
            "close safety popup": "closing safety popup",
            "unlock protective stop": "Protective stop releasing",
            "restart safety": "Restarting safety",
        }
        self.asked: list[str] = []
        self.dashboard_clients: list[socket.socket] = []
        self.banner = b"Connected: Universal Robots Dashboard Server\n"
        self.version = (5, 11, 5, 1010327)
        self.output_types = OUTPUT_TYPES
        self.input_types = INPUT_TYPES
        self.protocol_accepted = 1
        self.speed_fraction = 1.0
        self.digital_inputs = 0
        self.safety_mode = 1
        self.theta = UR5E_THETA
        self.a = UR5E_A
        self.checksums = (1, 2, 3, 4, 5, 6)
        self.spoil: Callable[[bytes], bytes] = lambda data: data  # of the primary interface
        self._closing = threading.Event()
        self._servers = [self._serve(self._dashboard), self._serve(self._primary), self._serve(self._rtde)]
        roles = ("dashboard", "primary", "rtde")
        self.endpoints = {
            role: f"tcp://{host}:{server.getsockname()[1]}"
            for role, server in zip(roles, self._servers, strict=True)
        }

    def close(self) -> None:
        self._closing.set()
        for server in self._servers:
            server.shutdown(socket.SHUT_RDWR)
            server.close()

    def state(self) -> bytes:
        return robot_state(
            self.speed_fraction, self.digital_inputs, self.checksums, self.theta, self.a, self.safety_mode
        )

    def _serve(self, talk: Callable[[socket.socket], None]) -> socket.socket:
        server = socket.create_server((self._host, 0))

        def accept() -> None:
            while True:
                try:
                    client, _ = server.accept()
                except OSError:
                    return
                threading.Thread(target=serve, args=(client,), daemon=True).start()

        def serve(client: socket.socket) -> None:
            with client, contextlib.suppress(OSError, struct.error):
                talk(client)

        threading.Thread(target=accept, daemon=True).start()
        return server

    def _dashboard(self, client: socket.socket) -> None:
        self.dashboard_clients.append(client)
        client.sendall(self.banner)
        for line in client.makefile("r", encoding="ascii"):
            self.asked.append(line.strip())
            answer = self.answers.get(line.strip(), "could not understand: " + line.strip())
            if answer is not None:
                client.sendall(answer.encode() + b"\n")

    def _primary(self, client: socket.socket) -> None:
        while not self._closing.wait(0.02):
            client.sendall(self.spoil(self.state()))

    def _rtde(self, client: socket.socket) -> None:
        stream: Any = client.makefile("rb")
        while header := stream.read(3):
            size, kind = struct.unpack(">HB", header)
            stream.read(size - 3)
            replies = {
                "V": bytes([self.protocol_accepted]),
                "v": struct.pack(">4I", *self.version),
                "O": b"\x01" + self.output_types.encode(),
                "I": b"\x01" + self.input_types.encode(),
            }
            client.sendall(rtde("M", b"\x02hi\x01m\x03") + rtde(chr(kind), replies[chr(kind)]))
