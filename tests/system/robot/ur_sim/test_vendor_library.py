"""The vendor's own integration tests of its C++ client library, against the simulated controller.

A checkout is given by an environment variable; nothing is downloaded. Which tests pass, and why the others do
not, is in docs/reference/ur-client-library.toml.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tomllib
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from ur_clients import UrCell

CHECKOUT = "RONNA_UR_CLIENT_LIBRARY"
GOOGLETEST = Path("/usr/src/googletest")  # Debian's package libgtest-dev
BUILD_LIMIT_S, LIMIT_S = 3600.0, 120.0  # host time, of the build and of one test
RESULTS: dict[str, Any] = tomllib.loads(
    (Path(__file__).parents[4] / "docs" / "reference" / "ur-client-library.toml").read_text(encoding="utf-8")
)
ASKED = {"ROBOT_MODEL": "ur5e"}  # without which a test is skipped
ATTEMPTS = 3

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(2.0 * BUILD_LIMIT_S),
    pytest.mark.skipif(
        CHECKOUT not in os.environ or not GOOGLETEST.is_dir() or shutil.which("cmake") is None,
        reason=f"left out: the vendor's C++ tests; {CHECKOUT} names a checkout of its client library, and "
        "cmake, g++ and libgtest-dev build it",
    ),
]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The library with its tests, copied and built: they write files beside themselves."""
    folder = tmp_path_factory.mktemp("vendor")
    unneeded = shutil.ignore_patterns(".git")
    shutil.copytree(os.environ[CHECKOUT], folder / "source", symlinks=True, ignore=unneeded)
    (folder / "source" / "test_artifacts").mkdir(exist_ok=True)
    options = {
        "BUILDING_TESTS": "ON",
        "INTEGRATION_TESTS": "ON",
        "CMAKE_BUILD_TYPE": "Debug",
        "FETCHCONTENT_FULLY_DISCONNECTED": "ON",
        "FETCHCONTENT_SOURCE_DIR_GOOGLETEST": str(GOOGLETEST),
    }
    given = [f"-D{name}={value}" for name, value in options.items()]
    programs = {suite["program"] for suite in RESULTS["suite"]}
    build("cmake", "-S", folder / "source", "-B", folder / "build", *given)
    build("cmake", "--build", folder / "build", "--target", *sorted(programs))
    return folder


def build(*words: str | Path) -> None:
    done = subprocess.run(words, capture_output=True, text=True, timeout=BUILD_LIMIT_S)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("suite", RESULTS["suite"], ids=lambda suite: suite["name"])
def test_what_needs_no_interpreter_passes(library: Path, tmp_path: Path, suite: dict[str, Any]) -> None:
    options = list(suite["options"])
    if "faults" in suite:
        (tmp_path / "faults.txt").write_text(suite["faults"], encoding="utf-8")
        options += ["--faults", str(tmp_path / "faults.txt")]
    left = sorted(name for name, result in suite["tests"].items() if result == "passes")
    outputs: dict[str, str] = {}
    # The library gives up when its computer pauses for 100 ms: what fails is tried again.
    for _ in range(ATTEMPTS):
        with ExitStack() as stack:
            cell = UrCell(stack, *options, number=2)
            outputs = {name: run_test(library, suite["program"], name, cell.address) for name in left}
        left = [name for name, output in outputs.items() if f"[       OK ] {name}" not in output]
        if not left:
            return
    pytest.fail("\n".join(outputs[name] for name in left))


def run_test(library: Path, program: str, name: str, address: str) -> str:
    """The output of one test in a process of its own, as the vendor's ctest runs it."""
    words = (
        library / "build" / "tests" / program,
        f"--gtest_filter={name}",
        *("--robot_ip", address, "--headless", "true"),
    )
    with (library / "output.txt").open("w+", encoding="utf-8", errors="replace") as output:
        try:
            subprocess.run(
                words,
                stdout=output,
                stderr=subprocess.STDOUT,
                timeout=LIMIT_S,
                cwd=library / "source" / "tests",
                env={**os.environ, **ASKED},
            )
        except subprocess.TimeoutExpired:
            output.write(f"{name} does not end within {LIMIT_S:g} s\n")
        output.seek(0)
        return output.read()
