"""`ronna-sim ur`: a Universal Robots controller with its arm, for any client."""

from __future__ import annotations

from typing import Annotated, Literal

import typer

from sim.world import options
from sim.world.background import start_in_background
from sim.world.options import ArmRole

FAULTS_OF = ("ur",)  # devices whose faults this simulator can have alone
MASTER = ArmRole.MASTER
DEFAULT_ADDRESS = "127.0.0.9"


def ur(
    address: Annotated[
        str, typer.Option(help="Address that has the controller's standard ports; one for each arm.")
    ] = DEFAULT_ADDRESS,
    model: Annotated[
        Literal["ur5", "ur5e", "ur3e", "ur10e", "ur16e"],
        typer.Option(
            case_sensitive=False,
            help="Arm: ur5 with a CB3 controller (125 Hz), the others with an e-Series (500 Hz); ur3e, ur10e "
            "and ur16e in the scene of a ur5e.",
        ),
    ] = "ur5e",
    lock_step: Annotated[
        bool,
        typer.Option(
            "--lock-step", help="While our script streams, a cycle begins once the client has answered."
        ),
    ] = False,
    parameter: options.SetOption = None,
    list_parameters: options.ListParametersOption = False,
    scene: options.SceneOption = "default",
    faults: options.FaultsOption = None,
    detach: options.DetachOption = False,
    world: options.WorldOption = None,
    role: options.RoleOption = MASTER,
) -> None:
    """Simulate a Universal Robots controller and its arm, for any client, until terminated.

    It serves RTDE (30004), the dashboard (29999) and the client interfaces (30001 to 30003) on its address,
    powered and in remote control.
    """
    from math import radians

    from sim.named_parameters import print_rows
    from sim.universal_robots.arm_in_world import ArmInWorld, require_arm
    from sim.universal_robots.controller import Controller
    from sim.universal_robots.controller_parameters import ControllerParameters
    from sim.universal_robots.cycle_loop import CycleLoop
    from sim.universal_robots.factory_calibration import calibrate
    from sim.universal_robots.kinematics import frame_of_matrix_mm
    from sim.universal_robots.model import MODELS
    from sim.world.drilling import DrilledSkull
    from sim.world.process import announce, end_with_parent, open_own_control_port, open_world
    from sim.world.rigid import matrix_of
    from sim.world.tool_load import SimulatedLoad
    from sim.world.true_arm import arm_seed

    if list_parameters:
        print_rows(ControllerParameters)
        return
    if detach and start_in_background("ur"):
        return
    parameters = ControllerParameters.parse(parameter or ()).of_arm(role.number)
    place = require_loopback(address)
    room = open_world(world, scene, faults, FAULTS_OF, paced=not lock_step, variant=model, role=role)
    described, truth = MODELS[model], room.scene.arm_of(role)
    require_arm(truth, described)
    seed = arm_seed(room.scene.seed, role)
    last = room.arm(role) if room.has_arm(role) else None
    start_rad = tuple(map(radians, truth.home_deg)) if last is None else last.joints_rad
    kinematics = calibrate(described, truth, seed, parameters.factory_calibration)
    controller = Controller(described, parameters, kinematics, start_rad, seed)
    controller.loads.on_tool = SimulatedLoad(room)
    if (held := room.scene.holders.get(role)) is not None:
        controller.loads.skull = DrilledSkull(room, role)
        controller.loads.hung_kg = room.hung_kg
        controller.loads.instrument = frame_of_matrix_mm(matrix_of(held.flange_from_clamp))
    drives = controller.robot.drives
    arm = ArmInWorld(truth, seed, room.publish_arm, drives, parameters, described.cycle_s, last)
    tool = room.mounted_tool if role is MASTER else (lambda: 0)
    cycle_loop = CycleLoop(controller, arm, tool, room, place, alone=world is None)
    control = open_own_control_port(world, room, FAULTS_OF)
    end_with_parent(cycle_loop.end)
    announce(
        "ur",
        control=control,
        endpoints=cycle_loop.endpoints,
        model=model,
        cycle_s=controller.model.cycle_s,
        version=controller.model.version_text,
    )
    cycle_loop.run()


def require_loopback(address: str) -> str:
    """Return an address of this computer alone; raises URC-002 for any other."""
    from ronna_hw.wire.universal_robots import RTDE_PORT
    from sim.universal_robots.connections import find_free
    from sim.universal_robots.errors import BAD_ADDRESS
    from sim.universal_robots.programs.outgoing import is_this_computer

    if is_this_computer(address):
        return address
    raise BAD_ADDRESS(
        f"a controller cannot be simulated at {address!r}",
        expected="an address in 127.0.0.0/8",
        action=f"Give an address of its own for each arm: --address {find_free(DEFAULT_ADDRESS, RTDE_PORT)}.",
    )
