"""A run that another program holds is left to it, and where that is operated is said."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from procedures.engine.errors import RunInUse
from procedures.engine.run_lock import held_run


def test_who_holds_a_run_is_named_and_nobody_is_told_to_end_it(tmp_path: Path) -> None:
    with (
        held_run(tmp_path),
        pytest.raises(RunInUse, match=f"pid {os.getpid()}") as refused,
        held_run(tmp_path),
    ):
        pass
    assert "watch" in refused.value.advice
    assert "end" not in refused.value.advice.lower().split()
