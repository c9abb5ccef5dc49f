"""Hostile bytes: a controller refuses them or does something, and runs on."""

from __future__ import annotations

import gc
import math
import os
import resource
import socket
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import pytest
from ur_mutants import COMMANDS, LINES, RTDE, SCRIPTS, SET_POINTS, mutants

from ronna_hw.endpoints import parse_endpoint
from ronna_hw.host.network import own_address
from ronna_hw.wire.universal_robots import DASHBOARD_PORT, SCRIPT_NAME
from sim.universal_robots import connections
from sim.universal_robots.connections import Handler, HangUp, Poll
from sim.universal_robots.controller import Controller
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.interfaces.clients import ClientInterfaces, ScriptHandler
from sim.universal_robots.interfaces.dashboard import Dashboard, LineHandler
from sim.universal_robots.interfaces.state_packages import StatePackages
from sim.universal_robots.model import MODELS
from sim.universal_robots.programs.recognition import REGISTER_LOOP_MARK, recognise
from sim.universal_robots.rtde.server import RtdeServer
from sim.universal_robots.rtde.session import BadPackage, Session

LONGEST_S = 1.0  # of CPU, for one stream and its cycles
CYCLES = 3
RENEWED_AFTER = 50  # streams
FARTHEST_RAD = 7.0  # a joint stands beyond its limit by what it needs to stop
PACKAGES_UNREAD = 10_000  # of a kilobyte: more than the system keeps for one who does not read
LONGEST_SCRIPT_BYTES = 1_000_000


class RtdeClient:
    """One RTDE client without a socket."""

    def __init__(self, target: Target) -> None:
        self._rtde, self._robot = target.rtde, target.controller.robot
        self._session = Session(target.rtde)

    def receive(self, data: bytes) -> bytes:
        """Take bytes, and pack a package of outputs."""
        try:
            self._session.receive(data)
        except BadPackage:
            self._rtde.forget(self._session)
            raise HangUp from None
        if self._session.output is not None:
            self._session.output.pack(self._robot.values)
        return b""

    def closed(self) -> None:
        """Has no socket."""


class ScriptClient:
    """A client whose scripts end, however they were changed."""

    def __init__(self, target: Target) -> None:
        self._handler = ScriptHandler(LONGEST_SCRIPT_BYTES, target.clients.take)

    def receive(self, data: bytes) -> bytes:
        """Take bytes, and what ends every script."""
        return self._handler.receive(data + b"\nend\nend\n")

    def closed(self) -> None:
        """Has no socket."""


class Target:
    """A controller with all its interfaces, driven without a clock."""

    def __init__(self, stack: ExitStack) -> None:
        self._opened = stack.enter_context(ExitStack())
        self.renew()

    def renew(self) -> None:
        """Begin anew with a controller that may move."""
        self._opened.close()
        self.controller = Controller(MODELS["ur5e"], ControllerParameters.parse(("power_on_s=0.01",)))
        self.poll, address = Poll(), own_address()
        poll = self.poll
        self._opened.callback(poll.close)
        self.rtde = RtdeServer(self.controller.robot, address, poll, seed=1)
        self.clients = ClientInterfaces(self.controller, address, poll)
        self.dashboard = Dashboard(self.controller, address, poll)
        for listener in (self.rtde.listener, self.dashboard.listener, *self.clients.listeners):
            self._opened.callback(listener.close)

    def feed(self, handler: Handler, stream: bytes) -> bool:
        """Hand over bytes and run some cycles; returns whether the client may go on."""
        began_s, goes_on = time.process_time(), True
        try:
            handler.receive(stream)
        except HangUp:
            goes_on = False
        for _ in range(CYCLES):
            self.controller.step()
            self.clients.send_state()
        self.controller.loads.publish_torques()
        packages = StatePackages(self.controller)
        assert packages.state()  # as any client may read them
        assert packages.realtime()
        joints = self.controller.robot.drives.target
        assert all(map(math.isfinite, joints)), stream
        assert max(map(abs, joints)) < FARTHEST_RAD, stream
        assert time.process_time() - began_s < LONGEST_S, stream
        return goes_on


@pytest.fixture
def target() -> Iterator[Target]:
    with ExitStack() as stack:
        yield Target(stack)


def started(target: Target, script: bytes, recipe: bytes) -> RtdeClient:
    """A client whose script runs and reads the registers of its recipe."""
    target.controller.start(recognise(script.decode(), target.controller.model.cycle_s))
    client = RtdeClient(target)
    client.receive(recipe)
    return client


ATTACKS: dict[str, tuple[tuple[bytes, ...], Callable[[Target], Handler]]] = {
    "packages of RTDE": (RTDE, RtdeClient),
    "commands in registers": (COMMANDS, lambda target: started(target, SCRIPTS[4], RTDE[4])),
    "set-points in registers": (SET_POINTS, lambda target: started(target, SCRIPTS[0], RTDE[3])),
    "lines of the dashboard": (LINES, lambda target: LineHandler(target.dashboard)),
    "scripts": (SCRIPTS, ScriptClient),
}


@pytest.mark.parametrize("attack", ATTACKS)
@pytest.mark.parametrize(
    ("count", "seed"),
    [(150, 1), pytest.param(100_000, 2, marks=(pytest.mark.soak, pytest.mark.timeout(3600)))],
)
def test_mutants_break_nothing(target: Target, attack: str, count: int, seed: int) -> None:
    """Each client goes on until it is hung up; each renewed controller may move."""
    seeds, connect = ATTACKS[attack]
    handler = connect(target)
    for number, stream in enumerate(mutants(seeds, count, seed)):
        if number % RENEWED_AFTER == 0 or not target.controller.modes.may_move:
            target.renew()
            handler = connect(target)
        if not target.feed(handler, stream):
            handler = connect(target)


def _external(constant: str) -> str:
    dial = 'socket_open("127.0.0.1", 1, "reverse_socket")'
    return f"def a():\n  MULT_jointstate = 1000000\n  {constant}\n  {dial}\nend\n"


@pytest.mark.parametrize(
    "text",
    [
        "def a():\n  set_payload(" + "e1" * 100_000 + ")\nend\n",
        "def a():\n  set_tcp(" + "[" * 300_000 + ")\nend\n",
        _external("servoj(lookahead_time" * 20_000),
        "def a():\n" + "if True: end\n" * 20_000 + "end\n",
        "def a():\n" + "\n" * 400_000 + "end\n",
        "[" * 20_000,
        "a." * 10_000,
        "def " + "a" * 300_000 + "():\nend\n",
    ],
    ids=["numbers", "brackets", "look-aheads", "blocks", "blank lines", "no program", "words", "name"],
)
def test_a_long_script_takes_time_in_proportion(target: Target, text: str) -> None:
    assert target.feed(ScriptClient(target), text.encode())


def test_many_scripts_at_once_take_no_longer_than_a_cycle_bears(target: Target) -> None:
    assert not target.feed(ScriptClient(target), b"x\n" * 30_000)


def test_a_long_line_of_the_dashboard_takes_time_in_proportion(target: Target) -> None:
    assert not target.feed(LineHandler(target.dashboard), b"a " * 30_000 + b"\n")


@pytest.mark.parametrize("text", ["a" * 300_000, "def " + "a" * 300_000 + "():\n  a\nend\n"])
def test_what_clients_are_told_of_a_long_script_stays_short(target: Target, text: str) -> None:
    told: list[str] = []
    target.controller.news.failure.append(lambda text, _line: told.append(text))
    target.controller.news.program.append(lambda _what, name: told.append(name))
    assert target.feed(ScriptClient(target), text.encode())
    assert target.feed(ScriptClient(target), text.replace("  a\n", "").encode())
    assert told
    assert max(map(len, told)) < 500


@pytest.mark.parametrize("call", ["set_payload(1e300, [1, 1, 1])", "set_tcp(p[1e200, 0, 0, 1e200, 0, 0])"])
def test_a_load_that_no_arm_carries_ends_no_package(target: Target, call: str) -> None:
    assert target.feed(ScriptClient(target), f"sec a():\n  {call}\nend\n".encode())


@pytest.mark.parametrize(
    "text",
    [
        _external(f"REVERSE_INTERFACE_DATA_DIMENSION = {'9' * 400}"),
        f"def a():\n  # {REGISTER_LOOP_MARK}\n  global reg_offset_int = {'9' * 5000}\nend\n",
        f"def a():\n  # {REGISTER_LOOP_MARK}\n  global reg_offset_int = 25\nend\n",
        f'def {SCRIPT_NAME}():\n  rtde_set_watchdog("input_int_register_24", 0.{"0" * 320}1, "stop")\nend\n',
    ],
    ids=["numbers of a message", "register", "registers beyond the last", "watchdog"],
)
def test_a_number_out_of_range_is_a_runtime_exception(target: Target, text: str) -> None:
    failures: list[str] = []
    target.controller.news.failure.append(lambda text, _line: failures.append(text))
    assert target.feed(ScriptClient(target), text.encode())
    assert "cannot run" in failures[0]


def test_without_a_descriptor_a_client_waits_at_rest_and_is_accepted_later(
    target: Target, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(connections, "ACCEPT_PAUSE_S", 0.0)
    listener, poll = target.dashboard.listener, target.poll
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    with socket.socket() as client:
        os.close(free := os.dup(client.fileno()))
        resource.setrlimit(resource.RLIMIT_NOFILE, (free, before[1]))
        try:
            client.connect((parse_endpoint(listener.endpoint).host, DASHBOARD_PORT))
            for _ in range(3):
                poll.serve(1.0)
        finally:
            resource.setrlimit(resource.RLIMIT_NOFILE, before)
        assert listener.connections == ()
        assert capsys.readouterr().err.count("cannot accept a client") == 1
        poll.serve(1.0)
        assert len(listener.connections) == 1


def test_of_a_client_that_never_read_nothing_is_kept_once_it_has_gone(target: Target) -> None:
    listener = target.clients.realtime
    address = parse_endpoint(listener.endpoint)
    with socket.socket() as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 2048)
        client.connect((address.host, address.port))
        target.poll.serve(1.0)
        gone = weakref.ref(listener.connections[0])
        for _ in range(PACKAGES_UNREAD):
            target.clients.send_state()
    while listener.connections:
        target.poll.serve(1.0)
    gc.collect()
    assert gone() is None
