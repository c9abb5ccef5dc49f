"""Runs programs of the benchmarks, and a group of measurements in its smallest size."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from marked_processes import list_marked, marked_environment

ROOT = Path(__file__).resolve().parents[3]
LIMIT_S = 420.0  # after the measurement's own limit; none takes half a minute on a quiet computer


def run_python(
    *words: str | Path, exit_code: int = 0, environment: dict[str, str] | None = None, limit_s: float = 50.0
) -> subprocess.CompletedProcess[str]:
    done = subprocess.run(
        [sys.executable, *words], cwd=ROOT, env=environment, capture_output=True, text=True, timeout=limit_s
    )
    assert done.returncode == exit_code, done.stderr
    return done


def run_smallest(name: str, folder: Path) -> list[dict[str, Any]]:
    """Run the group and return its figures; it must succeed, and leave neither a process nor a history."""
    mark, environment = marked_environment()
    words = ("-P", "benchmarks/run.py", "--only", name, "--smallest", "--out", folder)
    run_python(*words, environment=environment, limit_s=LIMIT_S)
    assert list_marked(mark) == []
    (file,) = folder.iterdir()
    figures: list[dict[str, Any]] = json.loads(file.read_text(encoding="utf-8"))["figures"][name]
    return figures
