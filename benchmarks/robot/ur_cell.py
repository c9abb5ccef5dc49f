"""Controllers of Universal Robots that measure the turnaround of a client, and one in lock-step."""

from __future__ import annotations

import contextlib
import select
import socket
import struct
import threading
import time
from contextlib import ExitStack
from typing import Self

from benchmarks.robot.robot_cell import SILENCE_LIMIT_S
from benchmarks.robot.turnaround import REPLY_LIMIT_S, Turnarounds
from drivers.universal_robots import UniversalRobotsArm
from drivers.universal_robots.realtime.packages import (
    ACTUAL,
    ECHO,
    INPUT,
    INPUT_FIELDS,
    OUTPUT,
    RECIPE_ID,
    ROBOT_MODE,
    RUN,
    RUNTIME_STATE,
    SAFETY_MODE,
    SCRIPT_STATE,
    SPEED_FRACTION,
    SPEED_SCALING,
    TARGET,
    TIMESTAMP,
)
from ronna_hw.arm.catalogue import ArmChoice
from ronna_hw.arm_stream.options import FOREMOST_PRIORITY
from ronna_hw.clock import open_clock
from ronna_hw.config import DeviceConfig
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_address
from ronna_hw.vectors import JointVector, joint_vector
from ronna_hw.wire.universal_robots import (
    RTDE_PORT,
    RUN_INPUT,
    SEQUENCE_INPUT,
    SET_POINT_INPUTS,
    PackageType,
    RobotMode,
    RuntimeState,
    SafetyMode,
    ScriptState,
)
from sim.world.scene.named_scenes import draw_scene
from sim.world.world import World

HOME_RAD: JointVector = (0.0, -1.5, -1.5, -1.5, 1.5, -1.5)
ROLES = ("rtde", "dashboard", "primary")
CYCLE_S = 0.002
FIRST_RECIPE = 1
FULL_SPEED = 1.0
BEGIN_S = 100.0  # time stamp of the first package
LONGEST = 65536
SCENE_SEED = 3
PRIMARY_PORT, SCRIPT_PORT, DASHBOARD_PORT = 30001, 30003, 29999
TYPE_PLACE = 2  # in a package
SO_TIMESTAMPNS = 35  # socket(7); stamps are a struct timespec of CLOCK_REALTIME
TIMESPEC = struct.Struct("qq")
STAMP_SPACE_BYTES = socket.CMSG_SPACE(TIMESPEC.size)
_FIRST_INPUT = RECIPE_ID + 1  # in an unpacked set-point
_SEQUENCE, _RUN = (_FIRST_INPUT + INPUT_FIELDS.index(name) for name in (SEQUENCE_INPUT, RUN_INPUT))
_SET_POINT = tuple(_FIRST_INPUT + INPUT_FIELDS.index(name) for name in SET_POINT_INPUTS)


def resting_values() -> list[float]:
    """Return the values of an output package of an arm at rest whose script awaits the first set-point.

    What the driver asks for beyond that is zero.
    """
    values: list[float] = list(OUTPUT.unpack(bytes(OUTPUT.size)))
    values[:TIMESTAMP] = OUTPUT.size, PackageType.DATA, FIRST_RECIPE
    values[TIMESTAMP] = BEGIN_S
    values[TARGET] = values[ACTUAL] = HOME_RAD
    values[SPEED_SCALING] = values[SPEED_FRACTION] = FULL_SPEED
    values[ROBOT_MODE], values[SAFETY_MODE] = RobotMode.RUNNING, SafetyMode.NORMAL
    values[RUNTIME_STATE], values[SCRIPT_STATE] = RuntimeState.PLAYING, ScriptState.WAITING
    return values


class ControllerStandIn(Turnarounds):
    """Listens for one client, which gets the packages of a controller and of our script at a given pace."""

    def __init__(self, reply_limit_s: float = REPLY_LIMIT_S, cycle_s: float = CYCLE_S) -> None:
        """Listen; a reply that takes longer than `reply_limit_s` is lost."""
        super().__init__()
        self._reply_limit_s = reply_limit_s
        self._cycle_s = cycle_s
        self._server = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp://127.0.0.1:{self._server.getsockname()[1]}"
        self._link: socket.socket | None = None
        self._goal = HOME_RAD
        self._values = resting_values()
        self.moved_rad = 0.0  # travel of the base so far: shows that a moving client really moves

    def block(self, count: int, pace_s: float) -> list[float]:
        self._connected()  # before any time is taken
        return super().block(count, pace_s)

    def exchange(self) -> None:
        link = self._connected()
        link.send(self.next_message())
        self.follow(link.recv(LONGEST))

    def ask(self, message: bytes) -> bytes | None:
        link = self._connected()
        link.send(message)
        try:
            return link.recv(LONGEST)
        except TimeoutError:
            return None

    def close(self) -> None:
        if self._link is not None:
            self._link.close()
        self._server.close()

    def _connected(self) -> socket.socket:
        if self._link is None:
            self._link, _ = self._server.accept()
            self._link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            self._link.settimeout(self._reply_limit_s)
            self._link.setblocking(False)
            with contextlib.suppress(BlockingIOError):  # its request to start, which an echo does not send
                self._link.recv(LONGEST)
            self._link.settimeout(self._reply_limit_s)
        return self._link

    def next_message(self) -> bytes:
        values = self._values
        values[TIMESTAMP] += self._cycle_s
        return OUTPUT.pack(*values)

    def follow(self, reply: bytes) -> None:
        if len(reply) != INPUT.size:
            return  # an echo
        inputs, values = INPUT.unpack(reply), self._values
        values[RUN] = inputs[_RUN]
        if inputs[_SEQUENCE]:
            goal = joint_vector(inputs[place] for place in _SET_POINT)
            self.moved_rad += abs(goal[0] - self._goal[0])
            self._goal = values[TARGET] = values[ACTUAL] = goal
            values[ECHO], values[SCRIPT_STATE] = inputs[_SEQUENCE], ScriptState.STREAMING


class Relay:
    """Passes on what client and controller send at the fixed ports of an address, and measures RTDE clients.

    The turnaround is from a data package until the kernel has received the client's next one.
    """

    def __init__(self, address: str, controller: str) -> None:
        self.address = address
        self._controller = controller
        self.turnarounds_s: list[float] = []
        ports = (RTDE_PORT, PRIMARY_PORT, SCRIPT_PORT, DASHBOARD_PORT)
        self._servers = [socket.create_server((address, port)) for port in ports]
        for server in self._servers:
            threading.Thread(target=self._accept, args=(server,), daemon=True).start()

    def close(self) -> None:
        for server in self._servers:
            with contextlib.suppress(OSError):
                server.shutdown(socket.SHUT_RDWR)
            server.close()

    def _accept(self, server: socket.socket) -> None:
        port = server.getsockname()[1]
        with contextlib.suppress(OSError):
            while True:
                client, _ = server.accept()
                controller = socket.create_connection((self._controller, port))
                for end in (client, controller):
                    end.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                client.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
                passage = _Passage(client, controller, self.turnarounds_s if port == RTDE_PORT else [])
                threading.Thread(target=passage.run, daemon=True).start()


class _Passage:
    """One connection through a relay, served by one thread: two would wait for each other's interpreter."""

    def __init__(self, client: socket.socket, controller: socket.socket, turnarounds_s: list[float]) -> None:
        self._client, self._controller = client, controller
        self._turnarounds_s = turnarounds_s
        self._sent_s = 0.0

    def run(self) -> None:
        """Pass on what arrives, until either side closes."""
        client, controller = self._client, self._controller
        with client, controller, select.epoll() as poll, contextlib.suppress(OSError):
            for end in (client, controller):
                poll.register(end, select.EPOLLIN)
            while True:
                for number, _ in poll.poll():
                    passed = self._to_client() if number == controller.fileno() else self._to_controller()
                    if not passed:
                        return

    def _to_client(self) -> bool:
        data = self._controller.recv(LONGEST)
        if _is_data(data):
            self._sent_s = time.clock_gettime(time.CLOCK_REALTIME)
        self._client.sendall(data)
        return bool(data)

    def _to_controller(self) -> bool:
        data, stamps, _, _ = self._client.recvmsg(LONGEST, STAMP_SPACE_BYTES)
        if self._sent_s and _is_data(data):
            self._turnarounds_s.append(_arrival_s(stamps) - self._sent_s)
            self._sent_s = 0.0
        self._controller.sendall(data)
        return bool(data)


def _arrival_s(stamps: list[tuple[int, int, bytes]]) -> float:
    """Return when the kernel received a package: how late the relay wakes up is no client's matter."""
    (_, _, stamp), *_ = stamps
    seconds, fraction_ns = TIMESPEC.unpack(stamp)
    return float(seconds + fraction_ns / 1e9)


def _is_data(data: bytes) -> bool:
    return len(data) > TYPE_PLACE and data[TYPE_PLACE] == PackageType.DATA


class UrCell:
    """`ronna-sim ur` with an active arm driver; in lock-step, or in real time behind a relay."""

    def __init__(self, *, lock_step: bool = True, real_time_priority: int = FOREMOST_PRIORITY) -> None:
        self._ending = ExitStack()
        scene = draw_scene("bench", seed=SCENE_SEED, arm=ArmChoice.UR5E)
        self.world = World.create(scene, paced=not lock_step)
        self.address = own_address(0)
        arguments = command("sim.cli", "ur", "--address", self.address, "--world", self.world.endpoint)
        self.controller = self._ending.enter_context(ChildProcess("ronna-sim ur", arguments))
        ready = self.controller.ready["endpoints"]
        self.relay = None if lock_step else Relay(own_address(1), self.address)
        endpoints = {role: ready[role] for role in ROLES}
        if self.relay is not None:
            self._ending.callback(self.relay.close)
            ports = {role: parse_endpoint(endpoint).port for role, endpoint in endpoints.items()}
            endpoints = {role: f"tcp://{self.relay.address}:{port}" for role, port in ports.items()}
        options = {"silence_limit_s": SILENCE_LIMIT_S, "real_time_priority": real_time_priority}
        config = DeviceConfig(driver="universal_robots", endpoints=endpoints, options=options)
        self.arm = UniversalRobotsArm("robot.master", config, open_clock(self.world.clock_endpoint))
        self._ending.callback(self.arm.close)

    def start(self) -> None:
        self.arm.connect()
        self.arm.configure()
        self.arm.activate()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._ending.close()
