"""A run held by another program is refused, with advice on where it is operated."""

from __future__ import annotations

import os
from pathlib import Path

from coded_errors import raises

from procedures.engine.errors import RUN_IN_USE
from procedures.runs.folders import hold_run


def test_the_error_names_the_process_that_holds_the_run_and_does_not_advise_ending_it(tmp_path: Path) -> None:
    with (
        hold_run(tmp_path),
        raises(RUN_IN_USE, match=f"pid {os.getpid()}") as refused,
        hold_run(tmp_path),
    ):
        pass
    assert "watch" in refused.value.advice
    assert "end" not in refused.value.advice.lower().split()
