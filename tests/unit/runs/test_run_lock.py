"""A run held by another program is refused, with advice on where it is operated."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from procedures.engine.errors import RunInUse
from procedures.runs.folders import hold_run


def test_the_error_names_the_process_that_holds_the_run_and_does_not_advise_ending_it(tmp_path: Path) -> None:
    with (
        hold_run(tmp_path),
        pytest.raises(RunInUse, match=f"pid {os.getpid()}") as refused,
        hold_run(tmp_path),
    ):
        pass
    assert "watch" in refused.value.advice
    assert "end" not in refused.value.advice.lower().split()
