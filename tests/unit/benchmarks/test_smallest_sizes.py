"""Every group of measurements starts, yields figures and leaves no process; pages are elsewhere."""

from __future__ import annotations

from pathlib import Path

import pytest
from smallest_benchmark import run_smallest

from benchmarks.measurements import MEASUREMENTS

PAGES = ("console", "planner")  # with the tests that have a browser


@pytest.mark.slow
@pytest.mark.timeout(450.0)  # only ends what hangs
@pytest.mark.parametrize("name", [name for name in MEASUREMENTS if name not in PAGES])
def test_a_group_of_measurements_yields_figures_in_its_smallest_size(name: str, tmp_path: Path) -> None:
    assert run_smallest(name, tmp_path)
