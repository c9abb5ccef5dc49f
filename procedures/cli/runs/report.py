"""`ronna-procedure report RUN`: the report of any run, rebuilt from its folder."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.leaving_report import seal_run
from procedures.cli.case.truth import truth_if_any
from procedures.cli.runs.left_runs import close_again
from procedures.engine.left_run import read_left_run
from procedures.engine.run_lock import held_run
from ronna_hw.command_line.messages import tell
from ronna_hw.evidence.inspection import inspected
from ronna_hw.evidence.manifest import BESIDE, REPORT_FILE, SEAL_FILE, is_closed, is_sealed
from ronna_hw.host.files import remove_folder, walk
from ronna_hw.host.process import interruption_deferred

if TYPE_CHECKING:
    from procedures.reporting.files import PostoperativeResult

NOT_INTO_IT = "The folder was not changed; with --out DIR a report shows what can still be read."


def make_report(run: Path, out: Path | None = None, *, after: PostoperativeResult | None = None) -> Path:
    """The report of any run folder, rebuilt; with `after`, the check after the operation is added to it.

    Raises without `out` PRO-030 where another program has it open, PRO-033 for one that was changed; OSError.
    """
    from procedures.reporting.files import drop_unconfirmed_truth
    from procedures.reporting.report import write_report

    with contextlib.nullcontext() if out else held_run(run):
        found = inspected(run)
        if out is None:
            found.require_unchanged(NOT_INTO_IT)
            drop_unconfirmed_truth(run)
            if is_closed(found.chain.lines) and not is_sealed(run):
                close_again(read_left_run(run))
        for problem in found.problems:
            tell(f"this run is not {'finished' if problem.unfinished else 'as it was left'}: {problem}")
        if out is not None:
            return write_report(run, truth=truth_if_any(run), out=out, after=after)
        beside = run / BESIDE
        try:
            write_report(run, truth=truth_if_any(run), out=beside, after=after)
            with interruption_deferred():
                _take_over(beside, run)
                seal_run(run)
        finally:
            remove_folder(beside)
    return run / REPORT_FILE


def _take_over(made: Path, run: Path) -> None:
    """Move a report into a run. The seal goes first: killed meanwhile it waits for its seal, and is whole."""
    if is_sealed(run):
        (run / SEAL_FILE).unlink()
    for path, *_ in sorted(walk(made)):
        place = run / path.relative_to(made)
        if path.is_file():
            place.parent.mkdir(exist_ok=True)
            path.replace(place)
