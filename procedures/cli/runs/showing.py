"""`ronna-procedure list`, `show`, `lineage` and `watch`: runs, results and live progress."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from pathlib import Path

from procedures.cli.case.case_lines import describe_loss, describe_state, entry_of, status_lines
from procedures.engine.events import CaseState, Event, Questioned, Refusal, SignalsLost
from procedures.engine.events.event_file import FollowedRun
from procedures.exchange.raw_readings import WRITES_ALL, missing_in_raw
from procedures.operator.margin import remark_on_limit
from procedures.reporting.ending import await_ending
from procedures.reporting.run_reading import read_for_report
from procedures.reporting.run_summary import RunSummary, summarize_run
from procedures.runs.folders import find_folders_of_runs, find_runs
from ronna_hw.command_line.terminal import (
    message_console,
    print_json,
    print_table,
    say,
    takes_escapes,
    tell,
)
from ronna_hw.evidence.inspection import inspect_run
from ronna_hw.text import format_count, printable


def list_runs(folder: Path, *, as_json: bool) -> None:
    """Print the runs in a folder, oldest first. Only the sources of the rows are compared."""
    rows = [summarize_run(read_for_report(run, every_file=False)) for run in find_runs(folder)]
    if as_json:
        print_json({"runs": [row.model_dump(mode="json") for row in rows]})
        return
    if not rows:
        say(f"no runs in {folder}")
        for holder in find_folders_of_runs(folder):
            say(f"{holder} holds runs: ronna-procedure list {shlex.quote(str(holder))}")
        return
    headings = ("run", "began", "strategy", "ended", "steps", "largest error mm")
    table = []
    for row in rows:
        began, error = str(row.began or "")[:16], _largest_error(row)
        table.append((printable(row.run), began, row.strategies, row.ended, len(row.done), error))
    print_table(f"Runs in {folder}", headings, table)
    for row in rows:
        if row.stop_lines:
            going_on = f"; next: {row.next_command}" if row.next_command else ""
            say(f"{printable(row.run)}: by the journal, {'; '.join(row.stop_lines)}{going_on}")
        for problem in row.problems:
            say(f"{printable(row.run)} is not reliable: {problem}")


def show_run(folder: Path, *, as_json: bool) -> None:
    """Print the steps of a run, its outcome and its target errors."""
    reading = read_for_report(folder)
    row, missing = summarize_run(reading), missing_in_raw(folder, tuple(reading.run.journal))
    if as_json:
        print_json(row.model_dump(mode="json") | {"raw_missing": missing})
        return
    for change in reading.changes:
        say(f"NOT AS THE RUN LEFT IT: {change}")
    theatre = str(row.theatre or "no theatre")
    seed = "" if row.seed is None or "seed" in theatre else f", seed {row.seed}"
    say(f"{row.run}: {theatre}{seed}, strategy {row.strategies or '-'}")
    if row.methods:
        say(str(row.methods))
    say(f"began {row.began or '-'}; {row.sentence}")
    if row.resumes:
        say(f"resumed {format_count(row.resumes, 'time')}")
    if (in_vain := row.restarts - row.only_leaving - row.resumes) > 0:
        say(f"taken up {format_count(in_vain, 'time')} without going on from what was left")
    if row.only_leaving:
        say(f"taken up {format_count(row.only_leaving, 'time')} only to go home, or to acknowledge a fault")
    held = "drill" if row.drill_held else "instrument"
    if row.instrument_in:
        say(f"the {held} was still in {row.instrument_in}")
    elif row.instrument_held_for:
        say(f"the {held} for {row.instrument_held_for} was still in the assistant's holder")
    for name, done in row.work_begun.items():
        say(f"work begun at {name}: {', '.join(done) or 'nothing confirmed yet'}")
    say(f"done: {', '.join(row.done) or 'nothing'}")
    if row.superseded:
        say(f"superseded: {', '.join(row.superseded)}")
    for target in row.targets:
        error_mm = target.application_error_mm
        known = "" if error_mm is None else f", error {error_mm:.3f} mm"
        if target.verdict:
            known += f", margin {target.margin_mm:g} mm: {target.verdict}"
        if remark := remark_on_limit(target.verdict, target.margin_mm, target.limit_mm):
            known += f", {remark}"
        say(f"{target.id}: predicted {target.predicted_tre_mm:.3f} mm{known}")
    if (bases := row.bases) is not None:
        say(f"two arms: head and ball meet within {bases.meeting_mm:.2f} mm")
    for name, one in row.insertions.items():
        say(f"the assistant inserted at {name}, {one.off_axis_mm:.2f} mm off the axis of the guide")
    for problem in reading.problems:
        say(f"not reliable: {problem}")
    for line in row.stop_lines:
        say(f"by the journal, {line}")
    if row.advice:
        say(f"what to do: {row.advice}")
    if row.next_command:
        say(f"next: {row.next_command}")
    if missing:
        say(f"{missing}; {WRITES_ALL}")


def draw_lineage(folder: Path, *, as_mermaid: bool) -> None:
    """Print results and their ancestors. Raises PRO-033 if files of the run have been changed."""
    from procedures.engine.run_folder import lineage_mermaid, lineage_text

    run = inspect_run(folder).require_unchanged()
    say((lineage_mermaid(run) if as_mermaid else lineage_text(run)).rstrip("\n"))


def _largest_error(row: RunSummary) -> str:
    error_mm = row.max_application_error_mm
    mark = "?" if row.problems else ""
    if error_mm is None:
        return mark or "-"
    return f"{error_mm:.3f}{mark}"


def watch(run: Path, *, as_json: bool) -> None:
    """Show a run's current state, then each event until it ends, then its ending. Raises CLI-005, PRO-018."""
    followed = FollowedRun(run)
    if followed.over:
        for change in inspect_run(run).changes:
            tell(f"NOT AS THE RUN LEFT IT: {change}")
    if as_json:
        _write_lines(followed, lambda event: event.model_dump_json(ensure_ascii=True))
    elif takes_escapes(sys.stderr):
        from procedures.cli.case.live_display import LiveDisplay

        display = LiveDisplay(message_console(), errors=True)
        with display.shown():
            for events in followed.batches():
                display.show(events)
        for _style, line in status_lines(display.view):
            tell(line)
    else:
        _write_lines(followed, line_of)
    if followed.closed:
        ending = await_ending(run)
        tell(f"{ending.word}: {ending.sentence}")
    else:
        tell("the run was ended without being closed")


def _write_lines(followed: FollowedRun, line_of: Callable[[Event], str | None]) -> None:
    for events in followed.batches():
        for event in events:
            if (line := line_of(event)) is not None:
                sys.stdout.write(line + "\n")
        sys.stdout.flush()


def line_of(event: Event) -> str | None:
    """Return a readable line for an event, or None if it only updates the display."""
    line = _line(event)
    return line and printable(line)


def _line(event: Event) -> str | None:
    if (entry := entry_of(event)) is not None:
        return f"{entry.mark} {entry.text}"
    match event.what:
        case CaseState(state=state, reason=reason):
            return describe_state(state, reason)
        case SignalsLost(count=count):
            return describe_loss(count)
        case Questioned(subject=subject, value=value):
            return f"? {subject}: {'; '.join(value.splitlines())}"
        case Refusal(step=step, unmet=unmet):
            return f"✗ {step} refused: {'; '.join(unmet)}"
        case _:
            return None
