"""`ronna-sim kuka`: a KR C4 with a KR 6 R900, for any RSI and EKI client."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sim.world import options
from sim.world.background import start_in_background
from sim.world.options import ArmRole, CycleMs

if TYPE_CHECKING:
    from ronna_hw.wire.kuka_context import RsiContext

RSI_DEFAULT = "udp://127.0.0.1:59152"
FAULTS_OF = ("robot",)  # devices whose faults this simulator can have alone
MASTER = ArmRole.MASTER


class Corrections(StrEnum):
    """How corrections accumulate."""

    ABSOLUTE = "absolute"
    RELATIVE = "relative"


def kuka(
    rsi: Annotated[
        str | None,
        typer.Option(help=f"Where the client listens [default: the Ethernet file's, or {RSI_DEFAULT}]."),
    ] = None,
    eki: Annotated[
        str, typer.Option(help="EKI channel of the C++ SDK; port 0 for any free one.")
    ] = "tcp://127.0.0.1:54600",
    eki_project: Annotated[
        str, typer.Option(help="EKI channel of this project; port 0 for any free one.")
    ] = "tcp://127.0.0.1:54602",
    rsi_config: Annotated[
        Path | None, typer.Option(help="KUKA Ethernet file (XML): layout of the telegrams.")
    ] = None,
    rsi_context: Annotated[
        Path | None, typer.Option(help="RSI context (TOML): wiring, limits, monitors.")
    ] = None,
    corrections: Annotated[
        Corrections | None, typer.Option(help="Argument of RSI_ON [default: the context's].")
    ] = None,
    cycle_ms: Annotated[
        CycleMs | None, typer.Option(help="Sensor cycle in ms [default: the context's].")
    ] = None,
    autostart: Annotated[
        bool, typer.Option("--autostart", help="Stream and accept corrections without EKI.")
    ] = False,
    parameter: options.SetOption = None,
    list_parameters: options.ListParametersOption = False,
    scene: options.SceneOption = "default",
    faults: options.FaultsOption = None,
    detach: options.DetachOption = False,
    world: options.WorldOption = None,
    role: options.RoleOption = MASTER,
) -> None:
    """Simulate a KUKA controller and its arm, for any client, until terminated.

    docs/how-to/extending/a-client-of-your-own.md shows a telegram, its reply and a request; with --verbose
    the log states why a reply was rejected.
    """
    from ronna_hw.endpoints import parse_endpoint
    from sim.kuka.autostart import Autostart
    from sim.kuka.controller import Controller
    from sim.kuka.controller_parameters import SUBMIT_CYCLE_S, ControllerParameters
    from sim.kuka.cycle_loop import CycleLoop
    from sim.kuka.eki.server import EkiServer
    from sim.kuka.manipulator import Manipulator
    from sim.kuka.rsi.link import resolve
    from sim.kuka.rsi.telegrams import TelegramWriter
    from sim.named_parameters import print_rows
    from sim.world.force_sensor import sensor_of
    from sim.world.process import announce, end_with_parent, open_own_control_port, open_world
    from sim.world.true_arm import arm_seed

    if list_parameters:
        print_rows(ControllerParameters)
        return
    if detach and start_in_background("kuka"):
        return
    parameters = ControllerParameters.parse(parameter or ()).of_arm(role.number)
    context = _read_context(rsi_config, rsi_context, corrections, cycle_ms, parameters.longest_file_name)
    ethernet = context.ethernet
    TelegramWriter(context.all_send, ethernet.precision, (0.0,) * 6, (0.0,) * 6)  # rejects a bad layout
    file_address = f"udp://{ethernet.pc_ip}:{ethernet.pc_port}"
    client = parse_endpoint(rsi or (file_address if rsi_config else RSI_DEFAULT)).require("udp")
    address = resolve(client)
    eki_address, project_address = (
        parse_endpoint(text, listening=True).require("tcp") for text in (eki, eki_project)
    )
    room = open_world(world, scene, faults, FAULTS_OF, role=role)
    if sensor_of(room, role) is not None:
        context = context.with_force_sensor()
    last_state = room.arm(role) if room.has_arm(role) else None
    arm = Manipulator(
        room.scene.arm_of(role), arm_seed(room.scene.seed, role), room.publish_arm, parameters, last_state
    )
    tool = room.mounted_tool if role is MASTER else (lambda: 0)
    controller = Controller(context, arm, tool, parameters)
    # In lock-step theatre time stands still while the submit interpreter loops: there it answers at once.
    project_server = EkiServer(project_address, SUBMIT_CYCLE_S if room.clock.paced else 0.0)
    sdk_server = EkiServer(eki_address, SUBMIT_CYCLE_S)
    cycle_loop = CycleLoop(
        controller, room, address, project_server, sdk_server, Autostart(controller, is_requested=autostart)
    )
    control = open_own_control_port(world, room, FAULTS_OF)
    end_with_parent(cycle_loop.end)
    announce(
        "kuka",
        control=control,
        endpoints={"rsi": str(client), "eki": sdk_server.endpoint, "eki_project": project_server.endpoint},
        **_describe_link(context, inferred=rsi_config is not None and rsi_context is None),
    )
    cycle_loop.run()


def _read_context(
    rsi_config: Path | None,
    rsi_context: Path | None,
    corrections: Corrections | None,
    cycle_ms: CycleMs | None,
    longest_name: int,
) -> RsiContext:
    from ronna_hw.wire.kuka_context import load_context
    from sim.kuka.rsi.ethernet_file import read_ethernet_file

    if rsi_config is not None:
        described = load_context(rsi_context) if rsi_context else None
        context = read_ethernet_file(rsi_config, described, longest_name)
    else:
        context = load_context(rsi_context)
        if rsi_context is None:  # clients that count on positions
            context = context.model_copy(update={"optional_send": ()})
    changes: dict[str, Any] = {}
    if corrections is not None:
        changes["corrections"] = corrections.value
    if cycle_ms is not None:
        changes["cycle_ms"] = int(cycle_ms.value)
    return context.model_copy(update={"program": context.program.model_copy(update=changes)})


def _describe_link(context: RsiContext, *, inferred: bool) -> dict[str, Any]:
    """Return the link facts for the READY line, including whether the wiring was inferred from the tags."""
    return {
        "wiring": "inferred" if inferred else "context",
        "wired": sorted({wire.object for wire in context.wiring}),
        "corrections": context.program.corrections,
        "cycle_ms": context.program.cycle_ms,
        "timeout_packets": context.ethernet.timeout_packets,
        "precision": context.ethernet.precision,
    }
