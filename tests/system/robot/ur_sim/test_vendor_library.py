"""The vendor's own integration tests of its C++ client library, against the simulated controller.

A checkout is given by an environment variable; nothing is downloaded. Which tests pass, and why the others do
not, is in docs/reference/ur-client-library.toml.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib
from collections.abc import Iterable
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from ur_clients import UrCell

CHECKOUT = "RONNA_UR_CLIENT_LIBRARY"
GOOGLETEST = Path("/usr/src/googletest")  # Debian's package libgtest-dev
LIMIT_S = 1800.0  # host time, of a program's tests or of the build
RESULTS: dict[str, Any] = tomllib.loads(
    (Path(__file__).parents[4] / "docs" / "reference" / "ur-client-library.toml").read_text(encoding="utf-8")
)
ASKED = {"ROBOT_MODEL": "ur5e", "URSIM_VERSION": "latest"}  # without which two tests are skipped
PASSED = re.compile(r"^\[ +OK \] (\w+\.\w+)", re.MULTILINE)

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(2.0 * LIMIT_S),
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
    done = subprocess.run(words, capture_output=True, text=True, timeout=LIMIT_S)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("suite", RESULTS["suite"], ids=lambda suite: suite["name"])
def test_what_needs_no_interpreter_passes(library: Path, tmp_path: Path, suite: dict[str, Any]) -> None:
    wanted = {name for name, result in suite["tests"].items() if result == "passes"}
    options = list(suite["options"])
    if "faults" in suite:
        (tmp_path / "faults.txt").write_text(suite["faults"], encoding="utf-8")
        options += ["--faults", str(tmp_path / "faults.txt")]
    output, left = "", wanted
    # The library gives up when its computer pauses for 100 ms: what fails so has a second attempt.
    for _ in range(2):
        with ExitStack() as stack:
            cell = UrCell(stack, *options, number=2)
            output = run_tests(library, suite["program"], left, cell.address)
        left = left - set(PASSED.findall(output))
        if not left:
            return
    pytest.fail(f"{sorted(left)}\n{output}")


def run_tests(library: Path, program: str, names: Iterable[str], address: str) -> str:
    done = subprocess.run(
        (
            library / "build" / "tests" / program,
            f"--gtest_filter={':'.join(sorted(names))}",
            *("--robot_ip", address, "--headless", "true"),
        ),
        capture_output=True,
        text=True,
        errors="replace",
        timeout=LIMIT_S,
        cwd=library / "source" / "tests",
        env={**os.environ, **ASKED},
    )
    return done.stdout
