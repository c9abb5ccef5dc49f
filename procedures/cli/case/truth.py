"""The truth about a simulated run, asked of the theatre's verifier: a command of its own."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from procedures.engine.errors import CommandRefused
from ronna_hw.errors import EXIT_DONE, EXIT_FAILED
from ronna_hw.host.child_process import ChildNotReady, command, finished_command

if TYPE_CHECKING:
    from procedures.reporting.outcome import Truth

NAME = "ronna-sim verify"
VERIFY_TIMEOUT_S = 60.0  # host time; it reads a few small files
THEATRE_FOLDER = "theatre"  # of a run that brought its theatre along


def truth_of(folder: Path) -> Truth:
    """What the verifier says about a run folder; raises PRO-013 with its words, PRC-001 if it hangs."""
    from procedures.reporting.outcome import Truth

    answer = finished_command(NAME, command("sim.cli", "verify", str(folder), "--json"), VERIFY_TIMEOUT_S)
    # A run that reached no target is a failure of that command, after its answer.
    if answer.returncode not in (EXIT_DONE, EXIT_FAILED) or not answer.stdout:
        raise CommandRefused(NAME, answer.stderr, answer.returncode)
    return Truth.model_validate_json(answer.stdout)


def truth_if_any(folder: Path) -> Truth | None:
    """As `truth_of`; None where there was no simulated theatre, or nothing yet to compare."""
    if not (folder / THEATRE_FOLDER).is_dir():
        return None
    try:
        return truth_of(folder)
    except (CommandRefused, ChildNotReady):
        return None
