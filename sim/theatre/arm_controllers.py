"""Controllers of the simulated arms: the simulator of each, and how a theatre file names its driver."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ronna_hw.host.network import own_address, own_udp_endpoint
from sim.errors import BadDeviceParameter
from sim.world import nominal_arm, universal_robots_arm


@dataclass(frozen=True)
class ArmController:
    """A controller: `device` is its command of ronna-sim, `roles` are the endpoints of a theatre file."""

    device: str
    driver: str
    roles: tuple[str, ...]
    model_option: str  # of the driver
    has_cycle_option: bool

    def entry(
        self, variant: str, endpoints: dict[str, str], silence_limit_s: float, cycle_ms: int | None
    ) -> dict[str, Any]:
        """Return the entry of the arm in a theatre file."""
        cycle = {} if cycle_ms is None else {"cycle_ms": cycle_ms}
        return {
            "driver": self.driver,
            "endpoints": {role: endpoints[role] for role in self.roles},
            "options": {self.model_option: variant, "silence_limit_s": silence_limit_s, **cycle},
        }

    def arguments(self, variant: str, cycle_ms: int | None) -> tuple[str, ...]:
        """Return the options of the simulator in a theatre. Raises SIM-010 for a cycle that is not its own."""
        if self is KUKA:
            free = "tcp://127.0.0.1:0"
            cycle = () if cycle_ms is None else ("--cycle-ms", str(cycle_ms))
            return (*cycle, "--rsi", own_udp_endpoint(), "--eki", free, "--eki-project", free)
        if cycle_ms is not None:
            raise BadDeviceParameter(
                f"the controller of {variant} has a fixed cycle", expected="no --cycle-ms with this arm"
            )
        return ("--address", own_address(), "--model", variant)


KUKA = ArmController("kuka", "kuka_rsi", ("rsi", "eki_project"), "variant")
