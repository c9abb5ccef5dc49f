"""A bare RTDE client that knows nothing of our driver, and a running Universal Robots controller."""

from __future__ import annotations

import socket
import struct
from collections.abc import Sequence
from contextlib import ExitStack
from typing import NamedTuple

from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_address
from ronna_hw.wire.universal_robots import ScriptState

LIMIT_S = 30.0
RUN = 4711
HEADER_BYTES = 3
SCRIPT = """def ronna_stream():
  CYCLE_S = {cycle_s}
  STARVED_CYCLES = {starved}
  LARGEST_STEP_RAD = 0.02
  STOP_DECELERATION_RAD_S2 = 10.0
  LOOKAHEAD_S = 0.03
  GAIN = 1000
  # the rest is not interpreted: "end" in a text does not count
  while True:
    if True:
      sync()
    end
  end
end
"""
OUTPUTS = (
    "timestamp,target_q,target_qd,output_int_register_24,output_int_register_25,output_int_register_26,"
    "robot_mode,safety_mode,runtime_state"
)
INPUTS = "input_int_register_24,input_int_register_25,input_int_register_26," + ",".join(
    f"input_double_register_{number}" for number in range(24, 30)
)
_OUTPUT = struct.Struct(">B13d5iI")
_INPUT = struct.Struct(">HBB3i6d")


class State(NamedTuple):
    """A package of `OUTPUTS`."""

    timestamp_s: float
    target_rad: tuple[float, ...]
    speed_rad_s: tuple[float, ...]
    used: int
    script: int
    run: int
    robot_mode: int
    safety_mode: int
    runtime: int


def script(cycle_s: float = 0.002, starved: int = 10) -> str:
    return SCRIPT.format(cycle_s=cycle_s, starved=starved)


def package(kind: str, payload: bytes = b"") -> bytes:
    return struct.pack(">HB", HEADER_BYTES + len(payload), ord(kind)) + payload


class RtdeClient:
    """One connection; every request waits for its reply."""

    def __init__(self, endpoint: str, version: int = 2, receive_bytes: int | None = None) -> None:
        address = parse_endpoint(endpoint)
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_STREAM)
        self.socket.settimeout(LIMIT_S)
        if receive_bytes is not None:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
        self.socket.connect((address.host, address.port))
        self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._received = b""
        assert self.ask("V", struct.pack(">H", version)) == b"\1"

    def next(self, kind: str) -> bytes:
        """The payload of the next package of that type."""
        while True:
            while len(self._received) < HEADER_BYTES or len(self._received) < self._size:
                data = self.socket.recv(65536)
                if not data:
                    raise ConnectionResetError
                self._received += data
            if self._size < HEADER_BYTES:
                raise ConnectionAbortedError("what arrives is no RTDE")
            payload, found = self._received[HEADER_BYTES : self._size], chr(self._received[2])
            self._received = self._received[self._size :]
            if found == kind:
                return payload

    @property
    def _size(self) -> int:
        return int.from_bytes(self._received[:2], "big")

    def ask(self, kind: str, payload: bytes = b"") -> bytes:
        self.socket.sendall(package(kind, payload))
        return self.next(kind)

    def set_up(self, rate_hz: float = 500.0) -> None:
        """Ask for what our script needs, and start."""
        assert self.ask("O", struct.pack(">d", rate_hz) + OUTPUTS.encode())[0]
        assert self.ask("I", INPUTS.encode())[0]
        assert self.ask("S") == b"\1"

    def put(self, sequence: int, order: int, run: int, joints_rad: Sequence[float]) -> None:
        self.socket.sendall(_INPUT.pack(_INPUT.size, ord("U"), 1, sequence, order, run, *joints_rad))

    def state(self) -> State:
        values = _OUTPUT.unpack(self.next("U"))
        return State(values[1], values[2:8], values[8:14], *values[14:])


class UrCell:
    """A controller as a process of its own."""

    def __init__(self, stack: ExitStack, *options: str, number: int = 0) -> None:
        self._stack = stack
        self.address = own_address(number)
        arguments = ("ur", "--address", self.address, *options)
        self.child = ChildProcess("controller", command("sim.cli", *arguments), timeout_s=LIMIT_S)
        stack.callback(self.child.stop)
        self.endpoints: dict[str, str] = self.child.ready["endpoints"]

    def rtde(self, version: int = 2, receive_bytes: int | None = None) -> RtdeClient:
        client = RtdeClient(self.endpoints["rtde"], version, receive_bytes)
        self._stack.callback(client.socket.close)
        return client

    def connect(self, name: str) -> socket.socket:
        address = parse_endpoint(self.endpoints[name])
        return socket.create_connection((address.host, address.port), timeout=LIMIT_S)

    def dashboard(self, line: str) -> str:
        """The answer to one command."""
        with self.connect("dashboard") as client, client.makefile("rw", newline="\n") as text:
            text.readline()
            text.write(f"{line}\n")
            text.flush()
            return text.readline().strip()


def stream(cell: UrCell) -> tuple[RtdeClient, list[float]]:
    """Start our script, and return a client whose first set-point is used."""
    client = cell.rtde()
    client.set_up()
    home = list(client.state().target_rad)
    client.put(0, 0, RUN, home)
    with cell.connect("primary") as primary:
        primary.sendall(script().encode())
        while client.state().script != ScriptState.WAITING:
            pass
    client.put(1, 0, RUN, home)
    while client.state().used != 1:
        pass
    return client, home
