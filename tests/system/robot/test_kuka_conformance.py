"""The robot suite on the simulated controller: everything passes, and it is safe by default elsewhere."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from conformance.report import CaseOutcome, run_suite
from conformance.target import DeviceChoice, device_under_test, resolve_target
from conformance.universal_robots import PROTOCOL
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.network import own_udp_endpoint

SUITE = "conformance.cli"


def _run(*arguments: str) -> tuple[int, dict[str, object]]:
    done = subprocess.run(
        command(SUITE, "robot", "--json", *arguments),
        capture_output=True,
        text=True,
        timeout=170,
        check=False,
    )
    return done.returncode, json.loads(done.stdout)


def _outcomes(report: dict[str, object]) -> dict[str, str]:
    cases = report["cases"]
    assert isinstance(cases, list)
    return {case["number"]: case["outcome"] for case in cases}


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_the_arm_passes_the_whole_suite_on_the_simulated_controller(tmp_path: Path) -> None:
    code, report = _run("--sim", "--report", str(tmp_path / "report.json"))
    assert set(_outcomes(report).values()) == {"PASS"}
    assert code == 0
    assert (tmp_path / "report.json").exists()


@pytest.mark.slow
@pytest.mark.timeout(180)
def test_at_an_endpoint_nothing_is_moved_without_permission() -> None:
    rsi = own_udp_endpoint()
    free = "tcp://127.0.0.1:0"
    arguments = command("sim.cli", "kuka", "--rsi", rsi, "--eki", free, "--eki-project", free)
    with ChildProcess("ronna-sim kuka", arguments) as child:
        eki = child.ready["endpoints"]["eki_project"]
        code, report = _run("--endpoint", f"rsi={rsi}", "--endpoint", f"eki_project={eki}")
    outcomes = _outcomes(report)
    moving = {"R11", "R12", "R13", "R14", "R15", "R21", "R26", "K16", "K20", "L29b", "L30b"}
    destructive = {"K17", "L30"}
    left_out = {number for number, outcome in outcomes.items() if outcome == "SKIP"}
    assert left_out == moving | destructive
    assert "FAIL" not in outcomes.values()
    assert code == 0


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
