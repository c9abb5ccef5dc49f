"""Probes are found like drivers; a driver without one is connected, identified and closed."""

from __future__ import annotations

from importlib.metadata import EntryPoint
from typing import Any

import pytest

from ronna_hw import registry
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.lifecycle import Identity
from ronna_hw.devices.probing import Finding, endpoints_of
from ronna_hw.errors import ConnectError

SCALES = DeviceConfig(driver="scales", endpoint="tcp://127.0.0.1:1")


class NothingThere(ConnectError):
    """A device that does not answer."""


class Scales:
    """A device of a kind that nobody here knows."""

    opened: list[Scales]
    present = True

    def __init__(self, name: str, config: DeviceConfig, clock: Any) -> None:
        self.closed = False
        self.opened.append(self)

    def connect(self, timeout_s: float) -> Identity:
        if not self.present:
            raise NothingThere("no reply", action="Switch it on.")
        return Identity("Lab", "S1", "7", "1.0")

    def close(self) -> None:
        self.closed = True


def scales_probe(name: str, config: DeviceConfig, progress: object) -> tuple[Finding, ...]:
    return (Finding(f"device {name}", False, "no load cell", "Plug it in."),)


@pytest.fixture
def declared(monkeypatch: pytest.MonkeyPatch) -> dict[str, list[str]]:
    """Group -> names of what the scales' package declares."""
    groups: dict[str, list[str]] = {registry.GROUP: ["Scales"], registry.PROBE_GROUP: []}

    def entry_points(*, group: str) -> list[EntryPoint]:
        return [EntryPoint("scales", f"{__name__}:{target}", group) for target in groups[group]]

    monkeypatch.setattr(registry, "entry_points", entry_points)
    monkeypatch.setattr(EntryPoint, "load", lambda point: globals()[point.attr])
    monkeypatch.setattr(Scales, "opened", [], raising=False)
    return groups


def probed(config: DeviceConfig = SCALES) -> Finding:
    (finding,) = registry.load_probe(config.driver)("scales", config, lambda share: None)
    return finding


def test_a_driver_brings_its_own_probe(declared: dict[str, list[str]]) -> None:
    declared[registry.PROBE_GROUP].append("scales_probe")
    assert probed().seen == "no load cell"
    assert Scales.opened == []


def test_a_driver_without_a_probe_is_identified_and_closed(declared: dict[str, list[str]]) -> None:
    assert probed() == Finding("device scales", True, "tcp://127.0.0.1:1: S1 7 1.0")
    assert [device.closed for device in Scales.opened] == [True]


def test_a_device_that_does_not_answer_is_closed_and_the_cause_is_named(
    declared: dict[str, list[str]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Scales, "present", False)
    finding = probed()
    assert not finding.well
    assert finding.advice.startswith("Nothing listens at tcp://127.0.0.1:1")
    assert probed(DeviceConfig(driver="scales", endpoint="serial:///dev/scales")).advice == "Switch it on."
    assert all(device.closed for device in Scales.opened)


def test_a_driver_that_is_not_installed_is_a_finding(declared: dict[str, list[str]]) -> None:
    finding = probed(DeviceConfig(driver="abacus", endpoint="tcp://127.0.0.1:1"))
    assert "DEV-002" in finding.seen


def test_a_probe_without_endpoint_schemes_is_not_offered_for_bare_endpoints(
    declared: dict[str, list[str]],
) -> None:
    declared[registry.PROBE_GROUP].append("scales_probe")
    assert registry.endpoint_probes() == {}


def test_all_endpoints_of_a_device_are_listed() -> None:
    roles = {"rsi": "udp://127.0.0.1:59152", "eki_project": "tcp://127.0.0.1:54602"}
    config = DeviceConfig(driver="kuka_rsi", endpoints=roles)
    assert [str(endpoint) for endpoint in endpoints_of(config)] == list(roles.values())
