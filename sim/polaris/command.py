"""`ronna-sim polaris`: the simulated tracker."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from sim.world.background import IN_BACKGROUND, DetachOption, start_in_background

SERIAL_PTY = "serial-pty"
FAULT_DEVICES = ("tracker", "room")  # whose faults a tracker started alone can have


class ModelName(StrEnum):
    """Supported tracker models."""

    SPECTRA = "spectra"
    VICRA = "vicra"


def polaris(
    endpoint: Annotated[
        str, typer.Option(help="serial-pty for a pseudo-terminal, or tcp://host:port.")
    ] = SERIAL_PTY,
    model: Annotated[ModelName, typer.Option("--profile", help="Model of the unit.")] = ModelName.SPECTRA,
    scene: Annotated[str, typer.Option(help="bench, bench-near, default, mini, or a file.")] = "bench",
    throttle: Annotated[bool, typer.Option(help="Send at the baud rate of the serial line.")] = False,
    wired: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Tool definition of a wired tool to plug in; repeatable."),
    ] = None,
    setting: Annotated[
        list[str] | None,
        typer.Option("--set", metavar="NAME=VALUE", help="Choose an unconfirmed behaviour; repeatable."),
    ] = None,
    list_parameters: Annotated[
        bool, typer.Option("--list-parameters", help="List the parameters that --set accepts, and exit.")
    ] = False,
    faults: Annotated[Path | None, typer.Option(help="Fault script, one fault per line.")] = None,
    detach: DetachOption = False,
    world: Annotated[str | None, typer.Option(hidden=True, help="World of a running theatre.")] = None,
) -> None:
    """Simulate an NDI Polaris Spectra or Vicra, for any client, until terminated."""
    from ronna_hw.endpoints import parse_endpoint
    from sim.named_parameters import rows
    from sim.polaris.line.interpreter import CommandInterpreter
    from sim.polaris.line.pseudo_terminal import PseudoTerminal
    from sim.polaris.line.server import EndSignal, Server, listen
    from sim.polaris.tracker_unit import Unit
    from sim.polaris.unit.behaviour import UnitBehaviour, parse_behaviour
    from sim.polaris.unit.model import UNIT_MODELS
    from sim.polaris.unit.ports import plug_in
    from sim.world.process import announce, end_with_parent, open_own_control_port, open_world

    if list_parameters:
        for name, value, meaning in rows(UnitBehaviour):
            typer.echo(f"{name}={value}  {meaning}")
        return
    if detach and not IN_BACKGROUND:
        start_in_background("polaris")
        return
    address = None if endpoint == SERIAL_PTY else parse_endpoint(endpoint, listening=True).require("tcp")
    behaviour = parse_behaviour(setting or [])
    kind = UNIT_MODELS[model.value]
    tools = plug_in(wired or [], kind.wired_ports, behaviour.user_memory_bytes)
    if scene == "bench" and model is ModelName.VICRA:
        scene = "bench-near"  # the usual bench is outside the Vicra's volume
    room = open_world(world, scene, faults, FAULT_DEVICES)
    unit = Unit(room, kind, behaviour, tools)
    interpreter = CommandInterpreter(unit)
    control = open_own_control_port(world, room, FAULT_DEVICES, unit.list_loaded_tools)
    end = EndSignal()
    server = Server(interpreter, end)
    end_with_parent(end.give)
    if address is None:
        line = PseudoTerminal(interpreter, throttle=throttle)
        announce("polaris", line.endpoint, control)
        server.serve_channel(line)
    else:
        with listen(address) as listener:
            host, port = listener.getsockname()[:2]
            announce("polaris", f"tcp://{host}:{port}", control)
            server.serve_network(listener)
