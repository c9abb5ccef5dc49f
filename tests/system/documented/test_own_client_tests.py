"""The tests on the page for other projects pass as written, with the clients of others that they show."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest
from documented import write_files

PAGE = "docs/how-to/extending/test-your-own-client.md"
LIMIT_S = 120.0


@pytest.mark.parametrize(
    ("client", "is_here", "passed"),
    [
        pytest.param("ndicapi", find_spec("ndicapy") is not None, 3, id="ndicapi"),
        pytest.param("rsipi", find_spec("RSIPI") is not None, 1, id="RSIPI", marks=pytest.mark.slow),
        pytest.param(
            "ur_rtde", find_spec("rtde_control") is not None, 1, id="ur-rtde", marks=pytest.mark.slow
        ),
        pytest.param(
            "aravis",
            shutil.which("arv-tool-0.8") is not None and shutil.which("arv-camera-test-0.8") is not None,
            2,
            id="Aravis",
            marks=pytest.mark.slow,
        ),
    ],
)
def test_the_page_tests_a_client_of_another_project(
    client: str, is_here: bool, passed: int, tmp_path: Path
) -> None:
    if not is_here:
        pytest.skip(f"left out: {client} as a client of the simulators")
    write_files(PAGE, tmp_path)
    done = subprocess.run(
        [sys.executable, "-P", "-m", "pytest", "-p", "sim.pytest_plugin", f"test_{client}.py"],
        cwd=tmp_path,
        # as in a project that has no other plugin, whether or not this one is installed by its entry point
        env={**os.environ, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", "PYTEST_ADDOPTS": ""},
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"{passed} passed" in done.stdout
