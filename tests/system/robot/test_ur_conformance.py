"""The robot suite starts a simulated Universal Robots controller, whose clock nobody else has."""

from __future__ import annotations

import pytest

from conformance.report import CaseOutcome, run_suite
from conformance.target import DeviceChoice, device_under_test, resolve_target
from conformance.universal_robots import PROTOCOL

QUICK = ("R06", "R07", "R11")  # holding, the device's clock, a motion


@pytest.mark.parametrize(
    "only", [QUICK, pytest.param((), marks=[pytest.mark.slow, pytest.mark.timeout(180)])]
)
def test_the_suite_passes_on_a_simulator_of_its_own(
    monkeypatch: pytest.MonkeyPatch, only: tuple[str, ...]
) -> None:
    monkeypatch.setattr("conformance.target.load_driver_protocol", lambda driver: PROTOCOL)
    target = resolve_target("robot", DeviceChoice(sim=True, driver="universal_robots"))
    with device_under_test(target) as dut:
        report = run_suite(target.suite.only(only), dut)
    assert {one.number: one.reason for one in report.results if one.outcome is not CaseOutcome.PASS} == {}
