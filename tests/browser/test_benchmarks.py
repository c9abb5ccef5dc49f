"""The measurements of the pages yield figures in their smallest size."""

from __future__ import annotations

from pathlib import Path

import pytest
from smallest_benchmark import run_smallest


@pytest.mark.slow
@pytest.mark.parametrize("name", ["console", "planner"])
def test_a_measurement_of_a_page_yields_figures(name: str, tmp_path: Path) -> None:
    assert run_smallest(name, tmp_path)
