"""`ronna-sim polaris`: the simulated tracker."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ronna_hw.wire.polaris import PolarisModel
from sim.world.background import start_in_background
from sim.world.options import DetachOption, FaultsOption, ListParametersOption, SetOption, WorldOption

SERIAL_PTY, ANY_PORT = "serial-pty", "tcp://127.0.0.1:0"
FAULT_DEVICES = ("tracker", "room")  # whose faults a tracker started alone can have


def polaris(
    endpoint: Annotated[
        str | None,
        typer.Option(
            help="serial-pty for a pseudo-terminal, or tcp://host:port; by default as the model is reached. "
            "igtl://host:port: its tools, served as PlusServer does by OpenIGTLink."
        ),
    ] = None,
    profile: Annotated[
        PolarisModel | None, typer.Option(help="Model of the unit, instead of the scene's.")
    ] = None,
    scene: Annotated[str, typer.Option(help="bench, bench-near, default, mini, or a file.")] = "bench",
    throttle: Annotated[bool, typer.Option(help="Send at the baud rate of the serial line.")] = False,
    wired: Annotated[
        list[Path] | None,
        typer.Option(metavar="FILE", help="Tool definition of a wired tool to plug in; repeatable."),
    ] = None,
    setting: SetOption = None,
    list_parameters: ListParametersOption = False,
    faults: FaultsOption = None,
    detach: DetachOption = False,
    world: WorldOption = None,
) -> None:
    """Simulate an NDI Polaris Spectra, Vicra or Vega, for any client, until terminated."""
    from ronna_hw.endpoints import parse_endpoint
    from sim.named_parameters import print_rows
    from sim.polaris.line.interpreter import CommandInterpreter
    from sim.polaris.line.pseudo_terminal import PseudoTerminal
    from sim.polaris.line.server import EndSignal, Server, listen
    from sim.polaris.tracker_unit import SimulatedUnit
    from sim.polaris.unit.behaviour import UnitBehaviour
    from sim.polaris.unit.model import UNIT_MODELS
    from sim.polaris.unit.ports import plug_in
    from sim.world.process import announce, end_with_parent, open_own_control_port, open_world

    if list_parameters:
        print_rows(UnitBehaviour)
        return
    if detach and start_in_background("polaris"):
        return
    behaviour = UnitBehaviour.parse(setting or [])
    if scene == "bench" and profile is PolarisModel.VICRA:
        scene = "bench-near"  # the usual bench is outside the Vicra's volume
    room = open_world(world, scene, faults, FAULT_DEVICES)
    kind = UNIT_MODELS[profile or room.scene.tracker.model]
    wanted = endpoint or (ANY_PORT if kind.networked else SERIAL_PTY)
    address = None if wanted == SERIAL_PTY else parse_endpoint(wanted, listening=True).require("tcp", "igtl")
    tools = plug_in(wired or [], kind.wired_ports, behaviour.user_memory_bytes)
    unit = SimulatedUnit(room, kind, behaviour, tools)
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
            announce("polaris", f"{address.scheme}://{host}:{port}", control)
            if address.scheme == "igtl":
                from sim.polaris.line.openigtlink_server import OpenIGTLinkServer

                OpenIGTLinkServer(unit, room.scene.tracker.tools, end).serve(listener)
            else:
                server.serve_network(listener)
