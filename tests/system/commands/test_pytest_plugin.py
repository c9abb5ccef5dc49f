"""The pytest plugin gives each test its own simulators, and leaves nothing of them behind."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
from contextlib import ExitStack
from pathlib import Path

import psutil
import pytest
from coded_errors import raises

from ronna_hw import open_theatre
from ronna_hw.host.network import own_address
from ronna_hw.wire.universal_robots import RTDE_PORT
from sim.errors import NO_FREE_ADDRESS, NO_SUCH_SIMULATOR
from sim.pytest_plugin import StartSimulator
from sim.simulators import MOST_ADDRESSES, Simulator

ENVIRONMENT = {**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""}
LIMIT_S = 120.0
FRESH_FOR_EACH = """
import os
from pathlib import Path
import pytest

def note(simulator):
    with Path("pids").open("a") as file:
        print(simulator._process.process.pid, file=file)

def test_fails_with_its_simulator_running(ronna_polaris):
    note(ronna_polaris)
    assert False, ronna_polaris.inject("tracker sunlight")

def test_has_another_one_and_a_second(ronna_polaris, ronna_simulator):
    second = ronna_simulator("polaris", "--profile", "vega")
    note(ronna_polaris)
    note(second)
    assert ronna_polaris.endpoint != second.endpoint
    with pytest.raises(Exception, match="SIM-003"):
        ronna_polaris.clear("tracker sunlight")

@pytest.mark.parametrize("ronna_polaris", [("--endpoint", "serial-pty")], indirect=True)
def test_has_the_options_of_its_parameter(ronna_polaris):
    assert os.path.exists(ronna_polaris.path)

def test_a_simulator_that_ends_by_itself_is_told(ronna_polaris):
    note(ronna_polaris)
    os.kill(ronna_polaris._process.process.pid, 9)
    ronna_polaris._process.process.wait()
"""
SHARED = """
import pytest

seen = []

@pytest.mark.parametrize("number", [1, 2])
def test_share_a_simulator_but_no_fault(ronna_polaris, number):
    seen.append(ronna_polaris.endpoint)
    assert len(set(seen)) == 1
    with pytest.raises(Exception, match="SIM-003"):
        ronna_polaris.clear("tracker sunlight")
    ronna_polaris.inject("tracker sunlight")
"""


def run_pytest(folder: Path, tests: str, *options: str) -> subprocess.CompletedProcess[str]:
    (folder / "test_inner.py").write_text(tests)
    return subprocess.run(
        [sys.executable, "-P", "-m", "pytest", "-p", "sim.pytest_plugin", "-q", *options, "test_inner.py"],
        cwd=folder,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )


def test_each_test_has_fresh_simulators_and_none_outlives_it(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, FRESH_FOR_EACH)
    assert "1 failed, 3 passed, 1 error" in done.stdout, done.stdout
    assert "ronna-sim polaris ended during the test" in done.stdout
    started = [int(line) for line in (tmp_path / "pids").read_text().split()]
    assert len(set(started)) == len(started) == 4
    assert [pid for pid in started if psutil.pid_exists(pid)] == []


def test_a_shared_simulator_has_no_fault_of_the_test_before(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, SHARED, "--ronna-shared")
    assert done.returncode == 0, done.stdout


def test_a_scene_that_does_not_exist_is_named_by_the_test_that_needs_it(tmp_path: Path) -> None:
    done = run_pytest(tmp_path, "def test(ronna_polaris): ...", "--ronna-scene", "no-such.toml")
    assert "SIM-001" in done.stdout
    assert "no-such.toml" in done.stdout


def test_an_unknown_simulator_is_named_with_the_nearest_one(ronna_simulator: StartSimulator) -> None:
    with raises(NO_SUCH_SIMULATOR, match="polaris"):
        ronna_simulator("polars")


def test_a_fourth_ur_controller_of_a_process_is_refused(ronna_simulator: StartSimulator) -> None:
    with ExitStack() as stack:
        for number in range(MOST_ADDRESSES):
            stack.enter_context(socket.create_server((own_address(number), RTDE_PORT)))
        with raises(NO_FREE_ADDRESS):
            ronna_simulator("ur")


@pytest.mark.slow
def test_a_theatre_opens_by_its_file_and_its_tools_can_be_hidden(ronna_theatre: Simulator) -> None:
    with open_theatre(ronna_theatre.file) as theatre, theatre.tracker.active() as tracker:
        name = next(iter(tracker.tools))
        assert tracker.read_frame().tool(name).position_mm is not None
        ronna_theatre.inject("tracker hide tool 1")
        assert any(tracker.read_frame().tool(name).position_mm is None for _ in range(120))


def test_a_run_without_simulators_imports_nothing_of_them() -> None:
    report = (
        "import sim.pytest_plugin, sys; "
        "print(sorted(name for name in sys.modules if name.split('.')[0] in ('sim', 'ronna_hw', 'numpy')))"
    )
    done = subprocess.run(
        [sys.executable, "-P", "-c", report], capture_output=True, text=True, check=True, env=ENVIRONMENT
    )
    assert done.stdout == "['sim', 'sim.pytest_plugin']\n"
