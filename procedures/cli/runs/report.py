"""`ronna-procedure report RUN`: the report of any run, made anew from its folder."""

from __future__ import annotations

import contextlib
from pathlib import Path

from procedures.cli.case.leaving_report import seal_run
from procedures.cli.case.truth import truth_if_any
from procedures.engine.run_lock import held_run
from ronna_hw.command_line.messages import tell
from ronna_hw.evidence.inspection import inspected

NOT_INTO_IT = "The folder is kept as it is; with --out DIR its report shows what can still be read."


def make_report(run: Path, out: Path | None = None) -> Path:
    """The report of any run folder, made anew.

    Raises without `out` PRO-030 where another program has it open, PRO-033 for one that was changed; OSError.
    """
    from procedures.reporting.report import write_report

    with contextlib.nullcontext() if out else held_run(run):
        found = inspected(run)
        if out is None:
            found.require_unchanged(NOT_INTO_IT)
        for problem in found.problems:
            tell(f"this run is not {'finished' if problem.unfinished else 'as it was left'}: {problem}")
        path = write_report(run, truth=truth_if_any(run), out=out)
        if out is None:
            seal_run(run)
    return path
