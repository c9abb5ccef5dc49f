"""`ronna-sim polaris`."""

from __future__ import annotations

from typing import Annotated

import typer

SERIAL_PTY = "serial-pty"


def polaris(
    endpoint: Annotated[
        str, typer.Option(help="serial-pty for a pseudo-terminal, or tcp://host:port.")
    ] = SERIAL_PTY,
    scene: Annotated[str, typer.Option(help="bench, default, mini, or a scene file.")] = "bench",
    throttle: Annotated[bool, typer.Option(help="Keep a serial line to its baud rate.")] = False,
    world: Annotated[str | None, typer.Option(hidden=True, help="World of a running theatre.")] = None,
) -> None:
    """Simulate an NDI Polaris Spectra, for any client; runs until it is ended."""
    from sim.polaris.channel import PseudoTerminal
    from sim.polaris.server import EndSignal, Server, listen, network_address
    from sim.polaris.session import Session
    from sim.polaris.unit import Unit
    from sim.theatre.process import announce, end_with_parent, open_world

    address = None if endpoint == SERIAL_PTY else network_address(endpoint)
    unit = Unit(open_world(world, scene))
    end = EndSignal()
    server = Server(Session(unit), end, unit.profile.longest_command)
    end_with_parent(end.give)
    if address is None:
        line = PseudoTerminal(throttle=throttle)
        announce("polaris", line.endpoint)
        server.serve_line(line)
    else:
        with listen(address) as listener:
            host, port = listener.getsockname()[:2]
            announce("polaris", f"tcp://{host}:{port}")
            server.serve_network(listener)
