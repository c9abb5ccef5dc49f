"""The interface that the device of each table of a theatre file must provide."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar, cast

from ronna_hw.devices.errors import WrongKind
from ronna_hw.devices.lifecycle import Device
from ronna_hw.devices.robot import RobotArm
from ronna_hw.devices.stereo import StereoPair
from ronna_hw.devices.tracker import OpticalTracker

D = TypeVar("D")

_OF_KIND: dict[str, Callable[..., Device]] = {
    "tracker": OpticalTracker,
    "robot": RobotArm,
    "stereo": StereoPair,
}


def interface_of(table: str) -> Callable[..., Device]:
    """That of a table such as `robot.master`; for `[device.NAME]` any device will do."""
    return _OF_KIND.get(table.partition(".")[0], Device)


def require_interface(table: str, driver: str, device: object, interface: Callable[..., D]) -> D:
    """The device of a table as `interface`, a runtime-checkable protocol or a class.

    Raises DEV-008 naming what the driver lacks.
    """
    if not isinstance(device, cast("type", interface)):
        lacking = [each for each in dir(interface) if each[0] != "_" and not hasattr(device, each)]
        raise WrongKind(
            f"{table}: driver {driver} does not provide {interface.__name__}",
            got=f"it lacks {', '.join(lacking)}" if lacking else None,
        )
    return cast("D", device)
