"""`ronna-conformance tracker` on the simulated unit, over TCP and over a pseudo-terminal."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from pathlib import Path
from typing import Any

import pytest

from ronna_hw.child_process import ChildProcess, command


def cases(report: dict[str, Any], outcome: str) -> set[str]:
    return {case["number"] for case in report["cases"] if case["outcome"] == outcome}


BYTES_AND_DRIVER = (
    "--only",
    "P0",
    "--only",
    "P1",
    "--only",
    "P2",
    "--only",
    "P3",
    "--only",
    "P4",
    "--only",
    "D",
)


def test_the_simulated_unit_passes_every_case_about_its_bytes(commands: Any, tmp_path: Path) -> None:
    report_file = tmp_path / "report.json"
    run = commands.run(
        "ronna-conformance", "tracker", "--sim", *BYTES_AND_DRIVER, "--report", str(report_file)
    )
    assert run.returncode == 0, run.stdout + run.stderr
    report = json.loads(report_file.read_text())
    assert cases(report, "FAIL") == set()
    assert cases(report, "SKIP") <= {"P01", "P08", "P49", "D40b"}
    assert len(cases(report, "PASS")) >= 40
    assert run.stdout.count("PASS") == len(cases(report, "PASS"))


@pytest.mark.slow
@pytest.mark.parametrize("line", ["serial-pty", "tcp://127.0.0.1:0"])
def test_the_driver_passes_every_case_on_either_line(commands: Any, line: str) -> None:
    with ChildProcess("ronna-sim polaris", command("sim.cli", "polaris", "--endpoint", line)) as unit:
        run = commands.run("ronna-conformance", "tracker", "--endpoint", unit.ready["endpoint"], "--json")
    assert run.returncode == 0, run.stdout + run.stderr
    report = json.loads(run.stdout)
    assert cases(report, "FAIL") == set()
    assert all(case["reason"] for case in report["cases"] if case["outcome"] == "SKIP")


def test_nobody_at_the_endpoint_is_one_message_and_exit_code_4(commands: Any) -> None:
    run = commands.run("ronna-conformance", "tracker", "--endpoint", "tcp://127.0.0.1:1")
    assert run.returncode == 4
    assert run.stdout == ""
    assert run.stderr.startswith("NDI-001")
    assert len(run.stderr.splitlines()) == 1


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ((), "CNF-001"),
        (("--sim", "--endpoint", "tcp://127.0.0.1:1"), "CNF-001"),
        (("--config", "no-such-file.toml"), "CFG-001"),
        (("--endpoint", "8765"), "CFG-002"),
        (("--sim", "--driver", "no_such_driver"), "DEV-002"),
        (("--sim", "--only", "Z"), "CNF-003"),
        (("--colour",), "CLI-001"),
    ],
)
def test_a_wrong_command_line_is_one_message_and_exit_code_2(
    commands: Any, arguments: tuple[str, ...], code: str
) -> None:
    run = commands.run("ronna-conformance", "tracker", *arguments)
    assert run.returncode == 2, run.stderr
    assert run.stderr.startswith(code)
    assert "Traceback" not in run.stderr


def test_a_report_that_cannot_be_written_is_told_before_the_work(commands: Any, tmp_path: Path) -> None:
    began_s = time.monotonic()
    run = commands.run(
        "ronna-conformance", "tracker", "--sim", "--report", str(tmp_path / "no" / "report.json")
    )
    assert run.returncode == 1
    assert run.stderr.startswith("CLI-005")
    assert time.monotonic() - began_s < 5.0


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_run_ends_its_simulator(commands: Any, number: int) -> None:
    run = commands.start("ronna-conformance", "tracker", "--sim")
    deadline = time.monotonic() + 10.0
    while len(commands.survivors()) < 2 and time.monotonic() < deadline:
        time.sleep(0.02)
    os.kill(run.pid, number)
    _, messages = run.communicate(timeout=10)
    assert run.returncode == 130
    assert "Traceback" not in messages


def test_help_answers_at_once(commands: Any) -> None:
    best_s = min(timed_help(commands) for _ in range(3))
    assert best_s < 0.4


def timed_help(commands: Any) -> float:
    began_s = time.monotonic()
    subprocess.run(commands.line("ronna-conformance", "--help"), capture_output=True, check=True)
    return time.monotonic() - began_s
