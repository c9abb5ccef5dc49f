"""Every run leaves a report, however it ended; what ended it is never hidden by that."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.request import CaseRequest, forget_if_empty, forget_if_refused
from procedures.cli.case.request_file import read_request
from procedures.cli.case.truth import truth_if_any
from procedures.journal.journal import JOURNAL_FILE
from ronna_hw.clock import ClockUnavailable
from ronna_hw.command_line.errors import as_ronna_error
from ronna_hw.command_line.messages import on_terminal, tell
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.evidence.manifest import (
    RAW_FOLDER,
    REPORT_FILE,
    REQUEST_FILE,
    closed_files,
    is_closed,
    not_vouched_for,
    seal,
)
from ronna_hw.host.files import remove_folder
from ronna_hw.host.process import interruptible
from ronna_hw.records import PARTIAL, write_whole

if TYPE_CHECKING:
    from procedures.reporting.outcome import RunError

FORMER = "former"  # raw readings of before, while new ones take their place
UNFINISHED = """<!DOCTYPE html><html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1"><title>{run}: not finished</title>
<h1>{run}: not finished</h1>
<p>This run has not left its report: it is still running, or it was killed, or the disk was full.
To write the report: <code>ronna-procedure report {folder}</code></p></html>
"""


def error_of(problem: BaseException) -> RunError | None:
    """What ended a run, as its report and its JSON have it; None for an interruption."""
    from procedures.reporting.outcome import RunError

    if not isinstance(problem, Exception):
        return None
    error = as_ronna_error(problem)
    return RunError(code=error.code, what=error.what)


def begin_report(folder: Path) -> None:
    """Leave a page that says that the run is not finished: a kill must not leave the end of before, or none.

    Nothing may depend on it, so a failure is not reported: the end of the run writes there too.
    """
    page = UNFINISHED.format(run=escape(folder.resolve().name), folder=escape(shlex.quote(str(folder))))
    with contextlib.suppress(OSError):
        write_whole(folder / REPORT_FILE, page.encode())


def leave_report(
    folder: Path, error: RunError | None = None, *, with_truth: bool = False, name_it: bool = True
) -> Path | None:
    """Write the report of a run that has ended; None when there is no folder or it cannot be written.

    Without the truth, which takes the verifier a second, an exit is not held up.
    """
    if not folder.is_dir():
        return None
    try:
        from procedures.reporting.report import write_report

        path = write_report(folder, truth=truth_if_any(folder) if with_truth else None, error=error)
    except Exception as problem:  # the run's own ending is what matters
        way = f"To write it: ronna-procedure report {shlex.quote(str(folder))}"
        tell(f"the report could not be written: {as_ronna_error(problem)} {way}")
        return None
    if name_it and on_terminal(sys.stderr):
        tell(f"report {path}")
    return path


def seal_run(folder: Path, *, at_once: bool = False) -> None:
    """Seal what a run left, its report included; what prevents it is said and hides nothing.

    Slow work is skipped when the end must come `at_once`, or when it is interrupted.
    """
    if not (folder / JOURNAL_FILE).exists():
        return
    if _wants_raw(folder):
        _keep_raw(folder, at_once=at_once)
    try:
        chain = read_chain(folder / JOURNAL_FILE)
        if is_closed(chain.lines):
            seal(folder, closed_files(chain.lines), not_vouched_for(chain.lines))
    except (RonnaError, OSError) as problem:
        tell(f"the run could not be sealed: {problem}")


def _wants_raw(folder: Path) -> bool:
    with contextlib.suppress(RonnaError, OSError):  # of another version, or of no case
        request = read_request(folder)
        return isinstance(request, CaseRequest) and request.keep_raw
    return False


def _keep_raw(folder: Path, *, at_once: bool) -> None:
    """Pictures and frames as files, again after each program of a run; those of before stay until then."""
    way = f"ronna-procedure raw {shlex.quote(str(folder))} --out DIR"
    later = f"the last raw readings were not written; to write them: {way}"
    if at_once:
        tell(later)
        return
    beside, kept = folder / f".{RAW_FOLDER}{PARTIAL}", folder / RAW_FOLDER
    try:
        from procedures.exchange.raw_readings import MOST_RAW_BYTES, write_raw

        _tidy(beside, kept)
        with interruptible():
            fresh, whole = write_raw(folder, beside / RAW_FOLDER)
        if kept.exists():  # the former ones go when these are whole
            kept.rename(beside / FORMER)
        fresh.rename(kept)
        if not whole:
            tell(f"{kept} stops at {MOST_RAW_BYTES / 1e9:g} GB; RUN/readings has everything")
    except KeyboardInterrupt:  # the run has ended: only this was left of it
        tell(later)
    except Exception as problem:  # a damaged tape must not hide how the run has ended
        tell(f"raw readings could not be written: {problem}")
    finally:
        _tidy(beside, kept)


def _tidy(beside: Path, kept: Path) -> None:
    """A process stopped between two renames has left the former readings next to them."""
    with contextlib.suppress(OSError):
        if not kept.exists():
            (beside / FORMER).rename(kept)
    if kept.exists() or not (beside / FORMER).exists():
        remove_folder(beside)


def tell_way_on(folder: Path, problem: BaseException) -> None:
    """After an interruption, or a failure away from home: where the arm is, and which commands continue."""
    if not (folder / REQUEST_FILE).exists():
        return
    from procedures.workcell.arm_history import history_left_by

    interrupted = isinstance(problem, KeyboardInterrupt)
    with contextlib.suppress(RonnaError, OSError):
        run = shlex.quote(str(folder))
        history = history_left_by(read_chain(folder / JOURNAL_FILE))
        if _left_by_another(folder):  # what ends this run names the commands of that one
            return
        if history.place.is_out or (interrupted and history.motions):
            first = _theatre_again(folder) if isinstance(problem, ClockUnavailable) else ""
            tell(
                f"the arm is where it stopped; {first or 'continue with'} ronna-procedure home {run} or "
                f"ronna-procedure resume {run}"
            )
        elif interrupted:
            tell(f"nothing has moved; continue with ronna-procedure resume {run}")


def _theatre_again(folder: Path) -> str:
    """What must come first where a simulated theatre has ended; empty for one of the run itself."""
    config = read_request(folder).config
    if config is None:
        return ""
    out = shlex.quote(str(config.parent))
    return f"its theatre has ended: start it again with ronna-sim theatre --out {out} --continue, then"


def _left_by_another(folder: Path) -> bool:
    """Whether another run on the same theatre left the arm away from home."""
    from procedures.cli.case.left_away import left_away
    from procedures.engine.theatre_lock import last_moved

    with contextlib.suppress(RonnaError, OSError):
        theatre = read_request(folder).config
        return theatre is not None and left_away(last_moved(theatre), folder) is not None
    return False


def end_unfinished(folder: Path, problem: BaseException) -> Path | None:
    """Leave the report and the seal of a run that `problem` ended, or no folder if it never began."""
    forget_if_refused(folder, problem)
    forget_if_empty(folder)
    report = leave_report(folder, error_of(problem))
    seal_run(folder, at_once=isinstance(problem, KeyboardInterrupt))
    tell_way_on(folder, problem)
    return report


@contextlib.contextmanager
def leaving_report(folder: Path, *, with_truth: bool = True) -> Iterator[None]:
    """Leave a report of the run in `folder` at the end of the block, whatever ends it."""
    try:
        yield
    except BaseException as problem:  # also an interruption: every run leaves a report
        end_unfinished(folder, problem)
        raise
    leave_report(folder, with_truth=with_truth)
    seal_run(folder)
