"""Parameters of single devices, passed to the whole theatre: `robot.lag_s=0.03`."""

from __future__ import annotations

from collections.abc import Sequence

from sim.errors import BadDeviceParameter
from sim.kuka.controller_parameters import changed_parameters
from sim.polaris.unit.behaviour import changed_behaviour

COMMANDS = {"robot": "kuka", "tracker": "polaris"}  # devices by their names in fault scripts


def parameters_by_device(settings: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """NAME=VALUE settings per device command.

    Raises SIM-010 for a device without parameters, KRC-003 or PSU-001 for an unknown parameter.
    """
    found: dict[str, tuple[str, ...]] = {}
    for setting in settings:
        device, dot, assignment = setting.partition(".")
        if device not in COMMANDS or not dot or "=" not in assignment:
            raise BadDeviceParameter(
                f"{setting!r} is not DEVICE.NAME=VALUE",
                expected=" or ".join(f"{name}.NAME=VALUE" for name in COMMANDS),
            )
        name = COMMANDS[device]
        found[name] = (*found.get(name, ()), assignment)
    changed_parameters(found.get("kuka", ()))
    changed_behaviour(found.get("polaris", ()))
    return found
