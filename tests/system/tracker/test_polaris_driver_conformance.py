"""`ronna-conformance tracker` on the simulated unit, over TCP and over a pseudo-terminal."""

from __future__ import annotations

import json
import os
import resource
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from ronna_hw.host.child_process import ChildProcess, command


def cases(report: dict[str, Any], outcome: str) -> set[str]:
    return {case["number"] for case in report["cases"] if case["outcome"] == outcome}


LINE_AND_MODES = ("--only", "P0", "--only", "P24", "--only", "P25", "--only", "P49")


def test_the_simulated_unit_passes_the_cases_about_its_line_and_its_modes(
    commands: Any, tmp_path: Path
) -> None:
    report_file = tmp_path / "report.json"
    run = commands.run("ronna-conformance", "tracker", "--sim", *LINE_AND_MODES, "--report", str(report_file))
    assert run.returncode == 0, run.stdout + run.stderr
    report = json.loads(report_file.read_text())
    assert cases(report, "FAIL") == cases(report, "SKIP") == set()
    assert len(cases(report, "PASS")) == 13
    assert run.stdout.count("PASS") == len(report["cases"])
    assert (
        run.stderr.strip()
        == f"tracker suite, driver ndi_polaris: {len(report['cases'])} pass, 0 fail, 0 skip"
    )


def whole_suite(commands: Any, *unit: str, timeout_s: float = 150.0) -> dict[str, Any]:
    """The report of every case on a simulated unit at an endpoint, everything allowed."""
    with ChildProcess("ronna-sim polaris", command("sim.cli", "polaris", *unit)) as child:
        run = commands.run(
            "ronna-conformance", "tracker", "--endpoint", child.ready["endpoint"], "--allow", "destructive",
            "--json", timeout_s=timeout_s,
        )  # fmt: skip
    assert run.stdout, run.stderr
    report: dict[str, Any] = json.loads(run.stdout)
    failed = {case["number"]: case["reason"] for case in report["cases"] if case["outcome"] == "FAIL"}
    assert failed == {}
    assert run.returncode == 0
    return report


@pytest.mark.slow
@pytest.mark.timeout(180)
@pytest.mark.parametrize("profile", ["spectra", "vicra"])
def test_every_case_passes_on_a_serial_line(commands: Any, profile: str) -> None:
    report = whole_suite(commands, "--profile", profile)
    assert cases(report, "SKIP") == set()
    assert profile in report["identity"]["model"].lower()


@pytest.mark.slow
@pytest.mark.timeout(180)
@pytest.mark.parametrize("options", [("--endpoint", "tcp://127.0.0.1:0"), ("--profile", "vega")])
def test_every_case_passes_over_tcp_except_those_about_a_serial_line(
    commands: Any, options: tuple[str, ...]
) -> None:
    report = whole_suite(commands, *options)
    assert cases(report, "SKIP") == {"P01", "P08", "D40b"}
    assert all(case["reason"] for case in report["cases"] if case["outcome"] == "SKIP")


@pytest.mark.soak
@pytest.mark.timeout(900)
def test_every_case_passes_at_the_pace_of_a_real_line(commands: Any) -> None:
    assert cases(whole_suite(commands, "--throttle", timeout_s=800.0), "SKIP") == set()


@pytest.mark.slow
def test_cases_that_reset_the_unit_are_skipped_without_permission(commands: Any) -> None:
    with ChildProcess("ronna-sim polaris", command("sim.cli", "polaris")) as unit:
        run = commands.run(
            "ronna-conformance", "tracker", "--endpoint", unit.ready["endpoint"], "--only", "P0", "--json"
        )
    report = json.loads(run.stdout)
    left_out = {case["number"]: case["reason"] for case in report["cases"] if case["outcome"] == "SKIP"}
    assert set(left_out) == {"P01", "P01b", "P09"}
    assert all("--allow destructive" in reason for reason in left_out.values())


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
def test_an_interrupted_run_ends_its_simulator(commands: Any, number: int) -> None:
    run = commands.start("ronna-conformance", "tracker", "--sim")
    deadline = time.monotonic() + 30.0
    while len(commands.survivors()) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(run.pid, number)
    _, messages = run.communicate(timeout=150)
    assert run.returncode == 130
    assert "Traceback" not in messages


def test_help_takes_little_processor_time(commands: Any) -> None:
    best_s = min(processor_time_s(commands) for _ in range(3))
    assert best_s < 0.4


def processor_time_s(commands: Any) -> float:
    """What the command itself takes, however busy the computer is."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(commands.line("ronna-conformance", "--help"), capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime - before.ru_utime + after.ru_stime - before.ru_stime
