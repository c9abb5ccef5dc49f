"""The example runs and prints the expected results."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

EXAMPLE = Path(__file__).parents[3] / "examples" / "register_points.py"


def test_the_example_pairs_registers_and_predicts():
    done = subprocess.run(
        [sys.executable, "-P", EXAMPLE], capture_output=True, text=True, timeout=30, check=True
    )
    assert "correspondence: UNIQUE" in done.stdout
    assert done.stdout.count("is tracker reading") == 5
    fre, rms, limit, error = (float(value) for value in re.findall(r"(\d+\.\d+) mm", done.stdout))
    assert 0.0 < fre < 1.0
    assert 0.0 < rms < limit < 1.0
    assert error < limit
