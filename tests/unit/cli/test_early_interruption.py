"""Interrupting a command during its imports prints one word and gives the documented exit code."""

from __future__ import annotations

import subprocess
import sys

import pytest

from ronna_hw.errors import EXIT_FAILED, EXIT_INTERRUPTED


def _ended(program: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-P", "-c", program], capture_output=True, text=True, timeout=150, check=False
    )


@pytest.mark.parametrize("package", ["procedures.cli", "sim.cli", "conformance.cli"])
def test_an_interrupt_during_import_prints_one_word(package: str) -> None:
    done = _ended(f"import {package}; raise KeyboardInterrupt")
    assert (done.returncode, done.stdout, done.stderr) == (EXIT_INTERRUPTED, "", "interrupted\n")


def test_any_other_exception_keeps_its_traceback() -> None:
    done = _ended("import procedures.cli; raise ValueError('a mistake')")
    assert done.returncode == EXIT_FAILED
    assert "Traceback" in done.stderr
    assert "ValueError: a mistake" in done.stderr
