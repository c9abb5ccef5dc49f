"""Each client on the page runs as written against its simulator, and sees what that simulates."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest
from documented import ROOT, write_files

from sim.pytest_plugin import StartSimulator

PAGE = "docs/how-to/extending/a-client-of-your-own.md"
LIMIT_S = 60.0


@pytest.mark.parametrize(
    ("client", "simulator", "sees"),
    [
        ("kuka", ("kuka", "--autostart"), ("A1 has turned to 0.9", 'Mode="EXT"')),
        ("ur", ("ur",), ("the wrist is at -1.47",)),
        (
            "polaris",
            ("polaris",),
            ("tool 01 is at [-150.15, -300.01, -1499.95] mm", "3 strays"),
        ),
        ("camera", ("basler",), ("acA2000-50gmNIR 21904411, ronna-sim, process", f"{2048 * 1088} pixels")),
    ],
)
def test_the_client_on_the_page_works_as_written(
    client: str,
    simulator: tuple[str, ...],
    sees: tuple[str, ...],
    tmp_path: Path,
    ronna_simulator: StartSimulator,
) -> None:
    write_files(PAGE, tmp_path)
    done = subprocess.run(
        [sys.executable, "-P", tmp_path / f"{client}_client.py"],
        cwd=ROOT,
        env=os.environ | ronna_simulator(*simulator).variables,
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert all(text in done.stdout for text in sees), done.stdout
