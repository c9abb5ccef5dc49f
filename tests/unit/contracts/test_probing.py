"""Probes are found like drivers; a device without a probe is connected, identified and closed."""

from __future__ import annotations

import importlib
import tomllib
from pathlib import Path

import pytest
from force_sensor import ScaledForceSensor, install

from ronna_hw import registry
from ronna_hw.config import DeviceConfig
from ronna_hw.devices.probing import Diagnostic, endpoints_of

ROOT = Path(__file__).resolve().parents[3]
ENDPOINT = "tcp://127.0.0.1:1"
CLOSED: list[str] = []


class Sensor(ScaledForceSensor):
    """Tells when it is closed."""

    def close(self) -> None:
        CLOSED.append(self.name)
        super().close()


def own_probe(name: str, config: DeviceConfig, progress: object) -> tuple[Diagnostic, ...]:
    return (Diagnostic(f"device {name}", False, "no load cell", "Plug it in."),)


@pytest.fixture(autouse=True)
def _installed(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, force=Sensor)
    CLOSED.clear()


def probed(driver: str = "force", endpoint: str = ENDPOINT) -> Diagnostic:
    config = DeviceConfig(driver=driver, endpoint=endpoint)
    (diagnostic,) = registry.load_probe(driver)("force", config, lambda share: None)
    return diagnostic


def test_a_driver_can_provide_its_own_probe(monkeypatch: pytest.MonkeyPatch) -> None:
    install(monkeypatch, {"force": own_probe}, force=Sensor)
    assert probed().seen == "no load cell"
    assert CLOSED == []
    assert registry.endpoint_probes() == {}  # it has no endpoint schemes


def test_every_driver_of_the_project_brings_its_own_probe() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    drivers, probes = (project["entry-points"][group] for group in (registry.GROUP, registry.PROBE_GROUP))
    assert set(probes) == set(drivers)
    for target in probes.values():
        module, _, name = target.partition(":")
        assert callable(getattr(importlib.import_module(module), name))


def test_a_device_without_a_probe_is_identified_and_closed() -> None:
    assert probed() == Diagnostic("device force", True, f"{ENDPOINT}: F1 7 1.0")
    assert CLOSED == ["force"]


def test_a_device_that_does_not_answer_is_closed_and_the_cause_is_reported(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Sensor, "plugged_in", False)
    diagnostic = probed()
    assert not diagnostic.well
    assert diagnostic.advice.startswith(f"Nothing listens at {ENDPOINT}")
    assert probed(endpoint="serial:///dev/scales").advice == "Switch it on."
    assert CLOSED == ["force", "force"]


def test_an_uninstalled_driver_gives_a_diagnostic_that_names_the_installed_ones() -> None:
    seen = probed("abacus").seen
    assert "DEV-002" in seen
    assert "expected one of" in seen


def test_all_endpoints_of_a_device_are_listed() -> None:
    roles = {"rsi": "udp://127.0.0.1:59152", "eki_project": "tcp://127.0.0.1:54602"}
    config = DeviceConfig(driver="kuka_rsi", endpoints=roles)
    assert [str(endpoint) for endpoint in endpoints_of(config)] == list(roles.values())
