"""`ronna-procedure theatre-history`: list a theatre file's states, find that of a run, restore one."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake


def theatre_history(
    theatre: Annotated[Path, Argument(metavar="THEATRE", help="The theatre file.")],
    run: Annotated[Path | None, Option(metavar="RUN", help="Say with which state this run was made.")] = None,
    restore: Annotated[
        int | None, Option(metavar="NUMBER", min=0, help="Put this state back in force, as another update.")
    ] = None,
    by: Annotated[str | None, Option(metavar="NAME", help="Who restores it.")] = None,
    as_json: terminal.JsonOption = False,
) -> None:
    """List the states of a theatre file that was updated by calibrations and ronna-tool, oldest first.

    Exit codes: 0 done, 2 usage or a bad file, 3 --by is no name, the history was changed, or a run uses the
    theatre.
    """
    from procedures.runs.theatre_history import (
        UpdateAuthor,
        describe_state,
        find_state,
        history_path,
        read_states,
    )
    from procedures.runs.theatre_history import restore as restore_state
    from procedures.runs.theatre_history_file import read_history
    from ronna_hw.config import read_theatre_file

    read_theatre_file(theatre)
    states = read_states(theatre)
    cut_off = read_history(history_path(theatre)).cut_off
    for number in cut_off:
        terminal.tell(f"line {number} of {history_path(theatre).name} was cut off by a crash: not counted")
    if restore is not None:
        from procedures.runs.theatre_lock import require_free_theatre
        from ronna_hw.devices.lifecycle import require_person

        if by is None:
            raise UsageMistake("--restore needs the name of who decides it", action="Add --by 'YOUR NAME'.")
        if restore >= len(states):
            raise UsageMistake(
                f"--restore: {theatre} has no state {restore}",
                expected="0" if len(states) == 1 else f"0 to {len(states) - 1}",
                action=f"ronna-procedure theatre-history {theatre} lists its states.",
            )
        person = require_person(by)
        require_free_theatre(theatre)
        restore_state(theatre, states[restore], UpdateAuthor(f"restored state {restore}", by=person))
        terminal.tell(f"state {restore} is in force again in {theatre}")
        return
    made_with = None if run is None else _read_hash(run)
    run_state = None if made_with is None else find_state(states, made_with)
    if as_json:
        rows = []
        for one in states:
            update = one.update and one.update.model_dump(exclude={"former", "text", "previous"})
            rows.append({"number": one.number, "sha256": one.sha256, "update": update})
        of_run = {} if run is None else {"run_state": run_state}
        terminal.print_json({"states": rows, "cut_off_lines": list(cut_off), **of_run})
        return
    table = [(one.number, one.sha256[:12], describe_state(one)) for one in states]
    terminal.print_table(f"States of {theatre}; the last is in force", ("state", "SHA-256", "since"), table)
    if run is not None:
        state = f"state {run_state}" if run_state is not None else "a state that this history does not know"
        terminal.say(f"{run.name} was made with {state}")


def _read_hash(run: Path) -> str | None:
    """Return the hash of the theatre file with which a run was first opened, or None if not recorded."""
    from procedures.journal.journal import JOURNAL_FILE
    from ronna_hw.evidence.journal_reading import read_chain

    if not (run / JOURNAL_FILE).exists():
        raise UsageMistake(
            f"--run: {run} is not the folder of a run",
            expected=f"a folder with {JOURNAL_FILE}",
            action="Give the run's own folder, such as runs/20261130T011529-s7-01d3.",
        )
    first, *_ = read_chain(run / JOURNAL_FILE).lines or ({},)
    found = first.get("theatre_sha256")
    return None if found is None else str(found)
