"""A million inputs, guided by the coverage of our code, for every parser of external input."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest
from good_inputs import PARSER_NAMES
from memory_folder import memory_folder

PROGRAM = Path(__file__).parents[1] / "support" / "hostile" / "guided_program.py"
LIMIT_S = 7000.0
pytestmark = [
    pytest.mark.soak,
    pytest.mark.timeout(7200),
    pytest.mark.skipif(importlib.util.find_spec("atheris") is None, reason="atheris is not installed"),
]

MILLION = 1_000_000
# atheris 3.0 keeps the result of every comparison of a NumPy array in instrumented code for ever (12.5 kB for
# 12,500 values): a process ends before that reaches the bound of memory.
OF_A_PROCESS = 200_000
TOLD = 3000  # characters of what went wrong


@pytest.mark.parametrize("name", PARSER_NAMES)
def test_a_million_coverage_guided_inputs_cost_a_bounded_amount(tmp_path: Path, name: str) -> None:
    with memory_folder(tmp_path) as folder:
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}
        for seed in range(MILLION // OF_A_PROCESS):
            given = [name, str(folder), str(tmp_path), str(OF_A_PROCESS), str(seed)]
            done = subprocess.run(
                [sys.executable, str(PROGRAM), *given],
                env=environment,
                capture_output=True,
                text=True,
                timeout=LIMIT_S,
                check=False,
            )
            assert done.returncode == 0, done.stderr[-TOLD:]
            assert f"number_of_executed_units: {OF_A_PROCESS}" in done.stderr
