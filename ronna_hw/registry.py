"""Driver name -> driver class, by entry point. Installing a package is all it takes to add a driver.

A driver's package declares, for example::

    [project.entry-points."ronna_hw.drivers"]
    my_tracker = "my_package.tracker:MyTracker"

The class is called as `MyTracker(name, config, clock)`.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any, Protocol

from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.errors import UnknownDriver
from ronna_hw.devices.lifecycle import Device

GROUP = "ronna_hw.drivers"


class DriverFactory(Protocol):
    """What an entry point of the group must be: a class or function with these three arguments."""

    def __call__(self, name: str, config: DeviceConfig, clock: Clock) -> Device: ...


def driver_names() -> tuple[str, ...]:
    """Names of all installed drivers."""
    return tuple(sorted(point.name for point in entry_points(group=GROUP)))


def load_driver(name: str) -> Any:
    """The driver class of that name; raises DEV-002 with the names that exist."""
    for point in entry_points(group=GROUP):
        if point.name == name:
            return point.load()
    raise UnknownDriver(f"no driver {name!r} is installed", awaited="one of " + ", ".join(driver_names()))


def make_device(name: str, config: DeviceConfig, clock: Clock) -> Any:
    """The driver object of one device of the theatre file. Nothing is opened yet."""
    factory: DriverFactory = load_driver(config.driver)
    return factory(name, config, clock)
