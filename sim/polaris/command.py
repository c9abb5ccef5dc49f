"""`ronna-sim polaris`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SERIAL_PTY = "serial-pty"


def polaris(
    endpoint: Annotated[
        str, typer.Option(help="serial-pty for a pseudo-terminal, or tcp://host:port.")
    ] = SERIAL_PTY,
    scene: Annotated[str, typer.Option(help="bench, default, mini, or a scene file.")] = "bench",
    throttle: Annotated[bool, typer.Option(help="Keep a serial line to its baud rate.")] = False,
    faults: Annotated[Path | None, typer.Option(help="Fault script, one fault per line.")] = None,
    world: Annotated[str | None, typer.Option(hidden=True, help="World of a running theatre.")] = None,
) -> None:
    """Simulate an NDI Polaris Spectra, for any client; runs until it is ended."""
    from sim.polaris.channel import PseudoTerminal
    from sim.polaris.server import EndSignal, Server, listen, network_address
    from sim.polaris.session import Session
    from sim.polaris.unit import Unit
    from sim.theatre.process import announce, end_with_parent, open_world

    address = None if endpoint == SERIAL_PTY else network_address(endpoint)
    room, control = open_world(world, scene, faults)
    unit = Unit(room)
    end = EndSignal()
    server = Server(Session(unit), end, unit.profile.longest_command)
    end_with_parent(end.give)
    if address is None:
        line = PseudoTerminal(throttle=throttle)
        announce("polaris", line.endpoint, control)
        server.serve_line(line)
    else:
        with listen(address) as listener:
            host, port = listener.getsockname()[:2]
            announce("polaris", f"tcp://{host}:{port}", control)
            server.serve_network(listener)
