"""Hostile bytes: a controller refuses them or does something, and runs on."""

from __future__ import annotations

import math
import selectors
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import pytest
from ur_clients import own_address
from ur_mutants import COMMANDS, LINES, RTDE, SCRIPTS, mutants

from sim.universal_robots.connections import HangUp
from sim.universal_robots.controller import Controller
from sim.universal_robots.controller_parameters import parse_parameters
from sim.universal_robots.interfaces.clients import ClientInterfaces
from sim.universal_robots.interfaces.dashboard import Dashboard, LineHandler
from sim.universal_robots.model import MODELS, ArmName
from sim.universal_robots.rtde.server import RtdeServer
from sim.universal_robots.rtde.session import BadPackage, Session

LONGEST_S = 1.0  # of CPU, for one stream and its cycles
CYCLES = 3
COUNTS = pytest.mark.parametrize(
    ("count", "seed"),
    [(150, 1), pytest.param(100_000, 2, marks=(pytest.mark.soak, pytest.mark.timeout(3600)))],
)


class Target:
    """A controller with all its interfaces, driven without a clock."""

    def __init__(self, stack: ExitStack) -> None:
        self.controller = Controller(MODELS[ArmName.UR5E], parse_parameters(("power_on_s=0.01",)))
        self._poll = stack.enter_context(selectors.DefaultSelector())
        address = own_address()
        self.rtde = RtdeServer(self.controller.robot, address, self._poll, seed=1)
        self.clients = ClientInterfaces(self.controller, address, self._poll)
        self.dashboard = Dashboard(self.controller, address, self._poll)
        for listener in (self.rtde.listener, self.dashboard.listener, *self.clients.listeners):
            stack.callback(listener.close)

    def step(self) -> None:
        for _ in range(CYCLES):
            self.controller.step()
            self.clients.send_state()
        joints = self.controller.robot.drives.target
        assert all(map(math.isfinite, joints))
        assert max(map(abs, joints)) < 10.0


@pytest.fixture
def target() -> Iterator[Target]:
    with ExitStack() as stack:
        yield Target(stack)


@COUNTS
def test_packages_of_rtde(target: Target, count: int, seed: int) -> None:
    session = Session(target.rtde)
    for stream in mutants(RTDE, count, seed):
        began_s = time.process_time()
        try:
            session.receive(stream)
        except BadPackage:
            target.rtde.forget(session)
            session = Session(target.rtde)
        if session.output is not None:
            session.output.pack(target.controller.robot.values)
        target.step()
        assert time.process_time() - began_s < LONGEST_S


@COUNTS
def test_commands_in_registers(target: Target, count: int, seed: int) -> None:
    session = Session(target.rtde)
    session.receive(RTDE[4])
    for stream in mutants(COMMANDS, count, seed):
        began_s = time.process_time()
        if target.controller.program is None:
            target.clients._take(SCRIPTS[4].decode())
        if not target.controller.modes.may_move:
            target.controller.modes.unlock_protective_stop()
        with suppress(BadPackage):
            session.receive(stream)
        session.unread = b""
        target.step()
        assert time.process_time() - began_s < LONGEST_S


@COUNTS
def test_lines_of_the_dashboard(target: Target, count: int, seed: int) -> None:
    handler = LineHandler(target.dashboard)
    for stream in mutants(LINES, count, seed):
        began_s = time.process_time()
        try:
            answer = handler.receive(stream)
            assert answer.count(b"\n") <= stream.count(b"\n")
        except HangUp:
            handler = LineHandler(target.dashboard)
        target.step()
        assert time.process_time() - began_s < LONGEST_S


@COUNTS
def test_scripts(target: Target, count: int, seed: int) -> None:
    handler = target.clients._connect_realtime(None)
    for stream in mutants(SCRIPTS, count, seed):
        began_s = time.process_time()
        try:
            handler.receive(stream + b"\nend\nend\n")
        except HangUp:
            handler = target.clients._connect_realtime(None)
        target.step()
        assert time.process_time() - began_s < LONGEST_S
