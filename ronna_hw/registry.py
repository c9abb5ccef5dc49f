"""Registry of drivers and probes by entry point: installing a package is enough to add one.

A driver's package declares, for example::

    [project.entry-points."ronna_hw.drivers"]
    my_tracker = "my_package.tracker:MyTracker"

The class is called as `MyTracker(name, config, clock)`. Probes are described in `devices/probing.py`.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import metadata
from importlib.metadata import EntryPoint
from typing import Any, Protocol

from ronna_hw.clock import Clock
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.errors import UNKNOWN_DRIVER
from ronna_hw.devices.lifecycle import Device
from ronna_hw.devices.probing import (
    Diagnostic,
    EndpointProbe,
    Finder,
    Inspection,
    Probe,
    Progress,
    connect_and_identify,
    inspect_nothing,
)
from ronna_hw.host.own_packages import OWN_PACKAGES, require_own_packages

GROUP = "ronna_hw.drivers"
PROBE_GROUP = "ronna_hw.probes"


@cache
def entry_points(*, group: str) -> metadata.EntryPoints:
    """Search a group once: each search reads a file of every installed package."""
    return metadata.entry_points(group=group)


def load_entry_point(point: EntryPoint) -> Any:
    """Load an entry point. Raises CFG-003 if a program's own `drivers` hides ours."""
    try:
        return point.load()
    except ImportError:
        package = point.module.partition(".")[0]
        if package in OWN_PACKAGES:
            require_own_packages((package,))
        raise


class DriverFactory(Protocol):
    """Target of a driver entry point: a class or function that takes these three arguments."""

    def __call__(self, name: str, config: DeviceConfig, clock: Clock) -> Device: ...


def list_driver_names() -> tuple[str, ...]:
    """List the names of all installed drivers."""
    return tuple(sorted(point.name for point in entry_points(group=GROUP)))


def load_driver(name: str) -> Any:
    """Load a driver class by name; raises DEV-002 listing the known names."""
    for point in entry_points(group=GROUP):
        if point.name == name:
            return load_entry_point(point)
    raise UNKNOWN_DRIVER(
        f"no driver {name!r} is installed", expected="one of " + ", ".join(list_driver_names())
    )


def make_device(name: str, config: DeviceConfig, clock: Clock) -> Device:
    """Create the driver object for a device of the theatre file; opens nothing."""
    factory: DriverFactory = load_driver(config.driver)
    return factory(name, config, clock)


def load_probe(driver: str) -> Probe:
    """Load the probe of a driver, by default one that connects, identifies and closes."""
    for point in entry_points(group=PROBE_GROUP):
        if point.name == driver:
            probe: Probe = load_entry_point(point)
            return probe
    return _probe_by_connecting


def endpoint_probes() -> dict[str, EndpointProbe]:
    """Return probes that can check bare endpoints, keyed by driver."""
    return {driver: probe for driver, probe in _load_probes() if isinstance(probe, EndpointProbe)}


def load_finders() -> dict[str, Finder]:
    """Load probes that can search lines and networks for their devices, keyed by driver."""
    return {driver: probe for driver, probe in _load_probes() if isinstance(probe, Finder)}


def _load_probes() -> list[tuple[str, Any]]:
    return sorted((point.name, load_entry_point(point)) for point in entry_points(group=PROBE_GROUP))


def _probe_by_connecting(
    name: str, config: DeviceConfig, progress: Progress, inspect: Inspection = inspect_nothing
) -> Sequence[Diagnostic]:
    return connect_and_identify(name, config, make_device, inspect=inspect)
