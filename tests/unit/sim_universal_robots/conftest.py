"""A controller without sockets."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from ronna_hw.host.network import own_address
from sim.universal_robots.connections import Poll
from sim.universal_robots.controller import Controller
from sim.universal_robots.controller_parameters import ControllerParameters
from sim.universal_robots.model import MODELS
from sim.universal_robots.rtde.server import RtdeServer

MakeController = Callable[..., Controller]


@pytest.fixture
def make() -> MakeController:
    def make_controller(*assignments: str, arm: str = "ur5e") -> Controller:
        return Controller(MODELS[arm], ControllerParameters.parse(assignments))

    return make_controller


@pytest.fixture
def controller(make: MakeController) -> Controller:
    return make()


@pytest.fixture
def serve() -> Iterator[Callable[[Controller], RtdeServer]]:
    servers: list[RtdeServer] = []
    poll = Poll()

    def open_server(controller: Controller) -> RtdeServer:
        servers.append(RtdeServer(controller.robot, own_address(), poll, seed=1))
        return servers[-1]

    yield open_server
    for server in servers:
        server.listener.close()
    poll.close()
