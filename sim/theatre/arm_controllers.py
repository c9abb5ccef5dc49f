"""Controllers of the simulated arms: the simulator of each, and the driver that a theatre file names."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from ronna_hw.arm import catalogue
from ronna_hw.host.network import own_address, own_udp_endpoint
from ronna_hw.wire.kuka_context import OWN_CONTEXT
from sim.errors import BAD_DEVICE_PARAMETER
from sim.kuka.controller_parameters import ControllerParameters as KukaParameters
from sim.named_parameters import ControllerOfArm
from sim.universal_robots.controller_parameters import ControllerParameters as UrParameters
from sim.universal_robots.factory_calibration import calibrate
from sim.universal_robots.model import MODELS
from sim.universal_robots.stated_chain import StatedChain, stated_chain
from sim.world.descriptions import DESCRIPTIONS
from sim.world.options import ArmRole
from sim.world.scene.model import ArmTruth, AssistantTruth, Scene

FREE = "tcp://127.0.0.1:0"
# 36 deg/s, the pace of the other arm, whose joints turn twice as fast at full speed.
UR_SPEED_FRACTION = 0.2


@dataclass(frozen=True)
class ArmController:
    """Controller of an arm.

    `device` is its command of ronna-sim, `roles` are the endpoints that its driver needs, `model_option` is
    the driver's option for the arm's name.
    """

    device: str
    driver: str
    roles: tuple[str, ...]
    model_option: str
    addresses: Callable[[str, int], tuple[str, ...]]  # options of the command, by the arm's name and number
    parameters: type[ControllerOfArm]
    files: tuple[str, ...] = ()  # options of the command: what is set up at the controller
    # Chain that the controller states of a true arm, by its seed and parameters; None: the model's.
    state_chain: Callable[[ArmTruth, int, tuple[str, ...]], StatedChain | None] = lambda truth, seed, _: None
    cycles_ms: tuple[int, ...] = ()  # to choose from
    speed_fraction: float | None = None  # of full joint speed, at work; None: the driver's own

    def arguments(self, variant: str, role: ArmRole, cycle_ms: int | None) -> tuple[str, ...]:
        """Return the options of the command in a theatre."""
        cycle = () if cycle_ms is None else ("--cycle-ms", str(cycle_ms))
        return (*cycle, *self.files, *self.addresses(variant, role.number), "--role", role.value)

    def serial(self, role: ArmRole, parameters: tuple[str, ...]) -> str:
        """Return the serial number that the controller of an arm in this role reports."""
        return str(self.parameters.parse(parameters).of_arm(role.number).serial_number)

    def device_entry(
        self,
        variant: str,
        endpoints: Mapping[str, str],
        silence_limit_s: float,
        cycle_ms: int | None,
        *,
        holder: AssistantTruth | None = None,
    ) -> dict[str, Any]:
        """Return the arm's table of a theatre file; `holder` is of an arm that has one."""
        cycle = {} if cycle_ms is None else {"cycle_ms": cycle_ms}
        speed = {} if self.speed_fraction is None else {"speed_fraction": self.speed_fraction}
        return {
            "driver": self.driver,
            "endpoints": {role: endpoints[role] for role in self.roles},
            "options": {
                self.model_option: variant,
                "silence_limit_s": silence_limit_s,
                **cycle,
                **speed,
                **({} if holder is None else _state_force(holder)),
            },
        }


def _state_force(holder: AssistantTruth) -> dict[str, Any]:
    """Return the options for the force on what a holder holds."""
    error_N = holder.force_error_N
    return {
        **({} if holder.force_sensor is None else {"force_sensor": True}),
        **({} if error_N is None else {"force_error_N": error_N}),
    }


def _state_measured_chain(truth: ArmTruth, seed: int, parameters: tuple[str, ...]) -> StatedChain:
    """Return the chain that the factory has measured."""
    kind = UrParameters.parse(parameters).factory_calibration
    measured = calibrate(MODELS[truth.variant], truth, seed, kind)
    return stated_chain(measured, DESCRIPTIONS[truth.variant])


KUKA = ArmController(
    device="kuka",
    driver=catalogue.DRIVERS[catalogue.KUKA],
    roles=("rsi", "eki_project"),
    model_option="variant",
    addresses=lambda _, number: ("--rsi", own_udp_endpoint(number), "--eki", FREE, "--eki-project", FREE),
    files=("--rsi-context", str(OWN_CONTEXT)),
    parameters=KukaParameters,
    cycles_ms=(4, 12),
)
# Its ports are fixed, so each arm of each theatre has an address of its own.
UNIVERSAL_ROBOTS = ArmController(
    device="ur",
    driver=catalogue.DRIVERS[catalogue.UNIVERSAL_ROBOTS],
    roles=("rtde", "dashboard", "primary"),
    model_option="model",
    addresses=lambda variant, number: ("--address", own_address(number), "--model", variant),
    parameters=UrParameters,
    state_chain=_state_measured_chain,
    speed_fraction=UR_SPEED_FRACTION,
)
CONTROLLERS = {catalogue.KUKA: KUKA, catalogue.UNIVERSAL_ROBOTS: UNIVERSAL_ROBOTS}  # by make


def controller_of(arm: ArmTruth) -> ArmController:
    """Return the controller that an arm is sold with."""
    return CONTROLLERS[DESCRIPTIONS[arm.variant].make.name]


def check_cycle(scene: Scene, cycle_ms: int | None) -> None:
    """Raise SIM-010 for a cycle that the controller of an arm in the scene does not have."""
    for role, arm in scene.arms.items():
        if cycle_ms is not None and cycle_ms not in controller_of(arm).cycles_ms:
            raise BAD_DEVICE_PARAMETER(
                f"the {role} is a {arm.variant}, whose cycle cannot be chosen",
                got=f"--cycle-ms {cycle_ms}",
                action="Omit --cycle-ms with this arm.",
            )


def device_name(scene: Scene, role: ArmRole) -> str:
    """Return the name of an arm in the READY line of a theatre: that of its controller, or `assistant`."""
    return controller_of(scene.arm).device if role is ArmRole.MASTER else role.value
