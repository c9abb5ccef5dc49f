"""A measurement that runs alone: its output, its failures, and that nothing of it stays."""

from __future__ import annotations

import signal
import subprocess
import sys
from pathlib import Path

import pytest
from marked_processes import list_marked, marked_environment
from smallest_benchmark import run_python
from waiting import eventually

ROOT = Path(__file__).resolve().parents[3]
# In a process of its own, since all of its children are ended.
RUN_ALONE = """
import sys
from benchmarks.isolation import run_alone
try:
    print("output:", run_alone([sys.executable, "-c", sys.argv[1]], float(sys.argv[2]), linger_s=0.3))
except RuntimeError as problem:
    print("failed:", problem)
"""
STUBBORN_CHILD = """
import subprocess, sys, time
child = "from signal import *; signal(SIGTERM, SIG_IGN); print(1, flush=True); import time; time.sleep(600)"
started = subprocess.Popen([sys.executable, "-c", child], stdout=subprocess.PIPE, start_new_session=True)
started.stdout.readline()
"""
WITH_RUNNER = """
import signal, subprocess, sys
from benchmarks.isolation import end_with_runner
signal.signal(signal.SIGTERM, signal.default_int_handler)
with end_with_runner():
    subprocess.run([sys.executable, "-c", "import time; foreign = time.sleep(600)"], start_new_session=True)
"""


def _run_alone(measurement: str, limit_s: float = 30.0) -> str:
    mark, environment = marked_environment()
    done = run_python("-c", RUN_ALONE, measurement, str(limit_s), environment=environment)
    assert list_marked(mark) == []
    return done.stdout


def test_a_measurement_returns_its_output_and_its_temporary_files_go() -> None:
    output = _run_alone("import tempfile; print(tempfile.mkdtemp())")
    folder = Path(output.removeprefix("output: ").strip())
    assert folder.is_absolute()
    assert not folder.exists()


def test_a_measurement_that_hangs_is_ended_with_a_child_that_has_a_session_of_its_own() -> None:
    output = _run_alone(STUBBORN_CHILD + "time.sleep(600)", limit_s=2.0)
    assert output == "failed: not finished within 2 s\n"


def test_a_measurement_that_fails_says_why_and_leaves_no_child() -> None:
    output = _run_alone(STUBBORN_CHILD + "sys.exit('no camera')")
    assert output == "failed: no camera\n"


def test_a_measurement_that_leaves_a_process_behind_has_failed() -> None:
    output = _run_alone(STUBBORN_CHILD)
    assert output.startswith("failed: left running: ")


def test_a_measurement_whose_runner_is_killed_ends_with_its_child_and_its_files(tmp_path: Path) -> None:
    mark, environment = marked_environment()
    with subprocess.Popen(
        [sys.executable, "-c", RUN_ALONE, WITH_RUNNER, "60"],
        cwd=ROOT,
        env=environment | {"TMPDIR": str(tmp_path)},
        stdout=subprocess.DEVNULL,
    ) as runner:
        eventually(lambda: any("foreign" in line for line in list_marked(mark)), 30.0)
        runner.kill()
    eventually(lambda: not list_marked(mark), 30.0)
    eventually(lambda: not list(tmp_path.iterdir()), 30.0)


@pytest.mark.slow
def test_an_interrupted_benchmark_leaves_nothing(tmp_path: Path) -> None:
    mark, environment = marked_environment()
    with subprocess.Popen(
        [sys.executable, "-P", "benchmarks/run.py", "--only", "recording", "--smallest", "--out", tmp_path],
        cwd=ROOT,
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as command:
        eventually(lambda: any("polaris" in line for line in list_marked(mark)), 60.0)
        command.send_signal(signal.SIGTERM)
        assert command.wait(60.0) == 130
    assert list_marked(mark) == []
    assert list(tmp_path.iterdir()) == []
