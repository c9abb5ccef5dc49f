"""Parameters of single devices, as one gives them to the whole theatre: `robot.lag_s=0.03`."""

from __future__ import annotations

from collections.abc import Sequence

from sim.errors import BadDeviceParameter

COMMANDS = {"robot": "kuka", "tracker": "polaris"}  # devices by the names that fault scripts use


def parameters_by_device(settings: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """NAME=VALUE of each device, by its command; raises SIM-010 for a device without parameters.

    Whether the device has the parameter is for the device to say.
    """
    found: dict[str, tuple[str, ...]] = {}
    for setting in settings:
        device, dot, assignment = setting.partition(".")
        if device not in COMMANDS or not dot or "=" not in assignment:
            raise BadDeviceParameter(
                f"{setting!r} sets nothing", awaited=" or ".join(f"{name}.NAME=VALUE" for name in COMMANDS)
            )
        name = COMMANDS[device]
        found[name] = (*found.get(name, ()), assignment)
    return found
