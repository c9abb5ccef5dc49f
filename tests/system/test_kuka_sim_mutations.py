"""Mutated telegrams over the sockets: the controller keeps running, and the arm does not move."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import islice

import pytest
from kuka_clients import Cell
from mutations import mutations

from sim.world.scene.named_scenes import named_scene
from sim.world.world import World

COUNT = 2_000
PER_CYCLE = 10
AWAY = (
    b'<Sen Type="%s"><Stop>1</Stop><AK A1="0.100000" A2="-0.1" A3="0.1" A4="0.1" A5="0.1" A6="0.1"/>'
    b"<IPOC>%d</IPOC></Sen>"
)
COMMANDS = (
    b'<Cmd Id="1" Name="STATUS"></Cmd>',
    b'<Cmd Id="2" Name="LIN" X="1" Y="2" Z="3" A="0" B="0" C="0" Vel="0.1"></Cmd>',
    b'<Cmd Id="3" Name="SET_TOOL" No="3" X="1" Y="2" Z="3" A="0" B="0" C="0"></Cmd>',
)
REQUESTS = (b'<External REQTYPE="5" CycleTime="1" ControlMode="1"></External>\n'.ljust(500, b"\0"),)


@pytest.fixture
def cell() -> Iterator[Cell]:
    world = World.create(named_scene("mini", seed=5), paced=False)
    with ExitStack() as stack:
        yield Cell(stack, world=world)
    world.clock.close()


def test_two_thousand_mutants_of_foreign_replies_move_nothing(cell: Cell) -> None:
    eki, rsi = cell.project(), cell.rsi
    cell.start(eki)
    rsi.cycles(20)
    resting = rsi.axes_deg
    wrong_type = AWAY % (b"ImFree", rsi.ipoc)
    mutants = mutations((AWAY, wrong_type), COUNT, seed=3)
    for _ in range(COUNT // PER_CYCLE):
        rsi.receive()
        for mutant in islice(mutants, PER_CYCLE):
            # Either the cycle or the type is another one; a mutation of a few bytes does not mend that.
            data = mutant.replace(b"%d", b"%d" % (rsi.ipoc - 400)).replace(b"%s", b"KROSHU")
            rsi.socket.sendto(data, rsi.source)
        rsi.answer()
        assert rsi.axes_deg == resting
    assert not list(mutants)
    assert rsi.late == 0
    assert eki.state(Id="8").get("RSI") == "2"


def test_the_controller_still_answers_after_mutated_requests_on_both_channels(cell: Cell) -> None:
    endpoints = cell.child.ready["endpoints"]
    for name, originals in (("eki_project", COMMANDS), ("eki", REQUESTS)):
        host, port = endpoints[name].removeprefix("tcp://").split(":")
        client: socket.socket | None = None
        for number, mutant in enumerate(mutations(originals, COUNT // 8, seed=9)):
            if client is None or number % 50 == 0:
                if client is not None:
                    client.close()
                client = socket.create_connection((host, int(port)), timeout=10.0)
            try:
                client.sendall(mutant)
                client.setblocking(False)
                with contextlib.suppress(BlockingIOError):
                    client.recv(65536)
                client.settimeout(10.0)
            except OSError:  # a memory that overflows ends the connection
                client.close()
                client = None
        if client is not None:
            client.close()
    state = cell.project().state(Id="8")
    assert (state.get("RSI"), state.get("Moving"), state.get("Err")) == ("0", "0", "0")
    assert cell.child.alive
