"""A file that was changed while a case was left is named, with what was expected and what helps."""

from __future__ import annotations

import contextlib
import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from coded_errors import raises
from finished_runs import finished_run

from procedures.engine.errors import RECOVERY_REFUSED
from procedures.runs.case import prepare_case
from procedures.runs.interrupted_run import Resumption, read_interrupted_run
from procedures.runs.lifecycle import open_run
from procedures.runs.observers import RunObservers
from procedures.runs.request import CaseProcedure, RunRequest
from ronna_hw.evidence.journal_reading import RUN_CHANGED
from ronna_hw.evidence.manifest import SEAL_FILE

THEATRE: Any = SimpleNamespace()


@pytest.fixture
def run(tmp_path: Path) -> Path:
    return finished_run(tmp_path / "run")


@pytest.mark.parametrize("content", ["= broken ][", None], ids=["no TOML", "missing"])
def test_a_plan_that_cannot_be_read_any_more_is_a_changed_input(run: Path, content: str | None) -> None:
    resumption = Resumption(read_interrupted_run(run), accepted=True)
    case = run.parent / "case"
    case.mkdir()
    if content is not None:
        (case / "plan.toml").write_text(content)
    request = RunRequest(procedure=CaseProcedure(case=case))
    with raises(RECOVERY_REFUSED, match="PRO-032") as refused, contextlib.ExitStack() as held:
        prepare_case(request, run, THEATRE, resumption, held)
    assert str(case / "plan.toml") in refused.value.what
    assert ("is not TOML" if content else "No such file") in str(refused.value.got)


def test_a_simulated_theatre_does_not_continue_in_another_scene(run: Path) -> None:
    shutil.copyfile(run / "request.json", run / "theatre" / "scene.json")
    (run / SEAL_FILE).unlink()
    left = read_interrupted_run(run, only_leaving=True)
    resumption = Resumption(left, accepted=True, only_leaving=True)
    request = RunRequest(procedure=CaseProcedure())
    with raises(RUN_CHANGED) as refused, open_run(request, run, RunObservers(), resumption):
        pass
    assert str(run / "theatre" / "scene.json") in refused.value.what
    assert "Put that file back" in refused.value.advice
