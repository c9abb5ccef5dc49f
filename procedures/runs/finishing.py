"""End of a run: report, seal and advice. Failures here never hide the cause of the end."""

from __future__ import annotations

import contextlib
import shlex
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.journal.journal import JOURNAL_FILE
from procedures.runs.folders import hold_run, remove_if_empty, remove_if_refused
from procedures.runs.request import CaseProcedure
from procedures.runs.request_file import read_request
from procedures.runs.simulated_theatre import find_truth
from ronna_hw.clock import ClockUnavailable
from ronna_hw.command_line.errors import as_ronna_error
from ronna_hw.command_line.messages import on_terminal, tell
from ronna_hw.command_line.options import require_output_folder
from ronna_hw.errors import RonnaError
from ronna_hw.evidence import manifest
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.evidence.unsealed import describe_unconfirmed_files
from ronna_hw.host.files import remove_folder, walk
from ronna_hw.host.process import allow_interruption, defer_interruption
from ronna_hw.records import PARTIAL, write_atomically

if TYPE_CHECKING:
    from procedures.reporting.files import PostoperativeResult
    from procedures.reporting.outcome import RunError
    from procedures.runs.interrupted_run import InterruptedRun

TAKE_OUT = "take it out by hand before anything else"
FORMER = "former"  # raw readings of before, while new ones take their place
UNFINISHED = """<!DOCTYPE html><html lang="en"><meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1"><title>{run}: not finished</title>
<h1>{run}: not finished</h1>
<p>This run has not left its report: it is still running, or it was killed, or the disk was full.
To write the report: <code>ronna-procedure report {folder}</code></p></html>
"""
NOT_INTO_IT = "The folder was not changed; with --out DIR a report shows what can still be read."


@dataclass
class Finalized:
    """Report of an ended run, or None until it is written."""

    report: Path | None = None


@contextlib.contextmanager
def finalize_run(
    folder: Path, left: InterruptedRun | None = None, *, with_truth: bool = True, name_report: bool = True
) -> Iterator[Finalized]:
    """After the block, write the run's report and seal, even if an error occurred.

    `left` is the run as it was found, if it had begun before.
    """
    final = Finalized()
    try:
        yield final
    except BaseException as problem:  # also an interruption: every run leaves a report
        final.report = end_unfinished_run(folder, problem, left)
        raise
    final.report = write_final_report(folder, with_truth=with_truth, tell_path=name_report)
    seal_run(folder, left)


def end_unfinished_run(
    folder: Path, problem: BaseException, left: InterruptedRun | None = None
) -> Path | None:
    """Write report and seal of a run that `problem` ended; remove the folder if it never began."""
    remove_if_refused(folder, problem)
    remove_if_empty(folder)
    report = write_final_report(folder, as_run_error(problem))
    seal_run(folder, left, at_once=isinstance(problem, KeyboardInterrupt))
    tell_next_commands(folder, problem)
    return report


@contextlib.contextmanager
def complete_seal(interrupted: InterruptedRun) -> Iterator[InterruptedRun]:
    """After the block, write the missing report and seal of a finished run that was killed."""
    from procedures.runs.reopening import prepare_folder, rewrite_end

    if manifest.is_sealed(interrupted.folder):
        yield interrupted
        return
    prepare_folder(interrupted)
    yield rewrite_end(interrupted)
    write_final_report(interrupted.folder, tell_path=False)
    seal_run(interrupted.folder)


def begin_report(folder: Path) -> None:
    """Write a provisional report page, in case the run is killed.

    A failure is not reported: nothing depends on it, and the end of the run writes there too.
    """
    page = UNFINISHED.format(run=escape(folder.resolve().name), folder=escape(shlex.quote(str(folder))))
    with contextlib.suppress(OSError):
        write_atomically(folder / manifest.REPORT_FILE, page.encode())


def write_final_report(
    folder: Path, error: RunError | None = None, *, with_truth: bool = False, tell_path: bool = True
) -> Path | None:
    """Write an ended run's report and return its path, or None if that is impossible.

    Asking the verifier for the truth takes a second.
    """
    if not folder.is_dir():
        return None
    try:
        from procedures.reporting.kept_truth import load_truth
        from procedures.reporting.report import write_report

        truth = find_truth(folder) if with_truth else load_truth(folder)
        path = write_report(folder, truth=truth, error=error, seals=True)
    except Exception as problem:  # the run's own ending is what matters
        way = f"To write it: ronna-procedure report {shlex.quote(str(folder))}"
        tell(f"the report could not be written: {as_ronna_error(problem)} {way}")
        return None
    if tell_path and on_terminal(sys.stderr):
        tell(f"report {path}")
    return path


def rebuild_report(run: Path, out: Path | None = None, *, after: PostoperativeResult | None = None) -> Path:
    """Rebuild the report of any run folder. `after` adds the postoperative check.

    The journal is not continued, and a run without a seal remains without one. Raises CLI-005 for an `out` in
    a run; without `out` PRO-030 where another program has the run open, PRO-033 for a changed one; OSError.
    """
    from procedures.reporting.kept_truth import drop_unsealed_truth, load_sealed_truth
    from procedures.reporting.report import write_report

    if out is not None:
        require_output_folder(out)
    with contextlib.nullcontext() if out else hold_run(run):
        found = inspect_run(run)
        if out is None:
            found.require_unchanged(NOT_INTO_IT)
            drop_unsealed_truth(run)
        for problem in found.problems:
            tell(f"this run is not {'finished' if problem.unfinished else 'as it was left'}: {problem}")
        unconfirmed = tuple(describe_unconfirmed_files(found))
        for sentence in unconfirmed:
            tell(sentence)
        write = partial(
            write_report,
            run,
            truth=load_sealed_truth(run) or find_truth(run),
            after=after,
            unconfirmed=unconfirmed,
        )
        if out is not None:
            return write(out=out)
        beside = run / manifest.BESIDE
        try:
            write(out=beside, seals=(run / JOURNAL_FILE).exists() and manifest.is_sealed(run))
            with defer_interruption():
                _take_over(beside, run)
        finally:
            remove_folder(beside)
    return run / manifest.REPORT_FILE


def as_run_error(problem: BaseException) -> RunError | None:
    """Convert the exception that ended a run for its report and JSON; None for an interruption."""
    from procedures.reporting.outcome import RunError

    if not isinstance(problem, Exception):
        return None
    error = as_ronna_error(problem)
    return RunError(code=error.code, what=error.what)


def seal_run(folder: Path, left: InterruptedRun | None = None, *, at_once: bool = False) -> None:
    """Seal the files of a run, including its report. Failures are reported, not raised.

    If its journal is still as it was `left`, no line names what was found changed or unconfirmed: that keeps
    its former hash, and a run without a seal remains without one. Slow work is skipped if the end must come
    `at_once`, or when it is interrupted.
    """
    if not (folder / JOURNAL_FILE).exists():
        return
    if _wants_raw(folder):
        _keep_raw(folder, at_once=at_once)
    try:
        chain = read_chain(folder / JOURNAL_FILE)
        if not chain.is_closed:
            return
        hashed, changed = manifest.Manifest(chain.lines), set[str]()
        former: dict[str, str] = {}
        reopened: tuple[str, ...] = ()
        if left is not None and left.run.chain.last == chain.last:
            if (found := manifest.read_seal(folder)) is None or not manifest.is_sealed(folder):
                return
            former, changed = found.files, {change.file for change in left.run.changes} | {*left.unsealed}
            reopened = found.reopened if left.unsealed else ()  # else by this program, which has ended whole
        kept = {name: sha256 for name, sha256 in former.items() if name in changed}
        manifest.seal(folder, hashed.files, {*hashed.unvouched_files, *changed}, kept, reopened)
    except (RonnaError, OSError) as problem:
        tell(f"the run could not be sealed: {problem}")


def _wants_raw(folder: Path) -> bool:
    with contextlib.suppress(RonnaError, OSError):  # of another version, or of no case
        procedure = read_request(folder).procedure
        return isinstance(procedure, CaseProcedure) and procedure.keep_raw
    return False


def _keep_raw(folder: Path, *, at_once: bool) -> None:
    """Export a run's raw pictures and frames, keeping an earlier export until the new one is complete."""
    way = f"ronna-procedure raw {shlex.quote(str(folder))} --out DIR"
    later = f"the last raw readings were not written; to write them: {way}"
    if at_once:
        tell(later)
        return
    beside, kept = folder / f".{manifest.RAW_FOLDER}{PARTIAL}", folder / manifest.RAW_FOLDER
    try:
        from procedures.exchange.raw_readings import MOST_RAW_BYTES, write_raw

        _tidy(beside, kept)
        with allow_interruption():
            fresh, whole = write_raw(folder, beside / manifest.RAW_FOLDER)
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
    """Restore the earlier raw readings if their replacement was interrupted."""
    with contextlib.suppress(OSError):
        if not kept.exists():
            (beside / FORMER).rename(kept)
    if kept.exists() or not (beside / FORMER).exists():
        remove_folder(beside)


def tell_next_commands(folder: Path, problem: BaseException) -> None:
    """After an interruption or failure, report where the arm is and which commands continue the run."""
    if not (folder / manifest.REQUEST_FILE).exists():
        return
    from procedures.workcell.arm_history import describe_instrument, fold_arms

    interrupted = isinstance(problem, KeyboardInterrupt)
    with contextlib.suppress(RonnaError, OSError):
        run = shlex.quote(str(folder))
        master, assistant = arms = fold_arms(read_chain(folder / JOURNAL_FILE))
        inside = describe_instrument(master.place, assistant.held)
        if _has_other_run_left_arm_away(folder):  # what ends this run names the commands of that one
            return
        if any(arm.place.is_out or (interrupted and arm.motions) for arm in arms):
            first = _describe_theatre_restart(folder) if isinstance(problem, ClockUnavailable) else ""
            moved = [arm.arm for arm in arms if arm.motions]
            where = "both arms are where they" if len(moved) > 1 else "the arm is where it"
            if inside is not None:
                where = f"{inside}, and {where}"
                if assistant.held is None:  # otherwise an arm leads it out
                    first = " ".join(filter(None, (f"{TAKE_OUT}, then", first)))
            tell(
                f"{where} stopped; {first or 'continue with'} ronna-procedure home {run} or "
                f"ronna-procedure resume {run}"
            )
        elif interrupted:
            tell(f"nothing has moved; continue with ronna-procedure resume {run}")


def _describe_theatre_restart(folder: Path) -> str:
    """Return advice on restarting a separate simulated theatre; empty if the run has its own."""
    config = read_request(folder).config
    if config is None:
        return ""
    out = shlex.quote(str(config.parent))
    return f"its theatre has ended: start it again with ronna-sim theatre --out {out} --continue, then"


def _has_other_run_left_arm_away(folder: Path) -> bool:
    """Whether another run on the same theatre left the arm away from home."""
    from procedures.runs.arm_notes import FormerRun
    from procedures.runs.theatre_lock import read_former_run

    with contextlib.suppress(RonnaError, OSError):
        request = read_request(folder)
        if (theatre := request.config) is not None:
            return read_former_run(theatre, folder, request.roles) != FormerRun()
    return False


def _take_over(source: Path, run: Path) -> None:
    """Move a new report into a run, unsealing only the report meanwhile in case of a kill."""
    sealed = (run / JOURNAL_FILE).exists() and manifest.is_sealed(run)
    if sealed:
        manifest.seal_report(run, finished=False)
    for path, *_ in sorted(walk(source)):
        place = run / path.relative_to(source)
        if path.is_file():
            place.parent.mkdir(exist_ok=True)
            path.replace(place)
    if sealed:
        manifest.seal_report(run)
