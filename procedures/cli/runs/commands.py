"""The commands about runs, as the command line has them. Their work is imported when they are called."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ronna_hw.command_line.console import JsonOption, LogLevelOption, VerboseOption, set_up_logging

RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")]


def resume_command(
    run_folder: RunArgument,
    accept: Annotated[
        bool, typer.Option("--accept", help="Accept what is found, unasked; in a simulated theatre only.")
    ] = False,
    answers: Annotated[
        Path | None, typer.Option(help="TOML file that answers the questions of the case.")
    ] = None,
    as_json: JsonOption = False,
    verbose: VerboseOption = False,
    log_level: LogLevelOption = None,
) -> None:
    """Go on with a run that was killed, left or interrupted.

    Nothing moves before devices, tool, calibrations, CT, plan, patient and robot base were read again and
    compared with the record, and accepted. Exit codes: 0 finished, 8 not taken up again.
    """
    set_up_logging(verbose)
    from procedures.cli.runs.resume import resume

    resume(run_folder, accept=accept, answers=answers, as_json=as_json, verbose=verbose)


def verify_command(run_folder: RunArgument, as_json: JsonOption = False) -> None:
    """Find every file of a run that is changed, missing or added; exit code 3 when there is one."""
    from procedures.cli.runs.verify import verify

    verify(run_folder, as_json=as_json)


def lineage_command(
    run_folder: RunArgument,
    mermaid: Annotated[bool, typer.Option("--mermaid", help="As a mermaid chart.")] = False,
) -> None:
    """Draw the results of a run and what each was made from; superseded ones are marked."""
    from procedures.cli.runs.showing import draw_lineage

    draw_lineage(run_folder, as_mermaid=mermaid)


def list_command(
    folder: Annotated[Path, typer.Argument(metavar="[DIR]", help="Folder of runs.")] = Path("runs"),
    as_json: JsonOption = False,
) -> None:
    """List the runs of a folder and how each ended."""
    from procedures.cli.runs.showing import list_runs

    list_runs(folder, as_json=as_json)


def show_command(run_folder: RunArgument, as_json: JsonOption = False) -> None:
    """Show what a run did, how it ended, and the errors at its targets."""
    from procedures.cli.runs.showing import show_run

    show_run(run_folder, as_json=as_json)


def add_commands(app: typer.Typer) -> None:
    """Give an application these commands."""
    app.command("resume")(resume_command)
    app.command("verify")(verify_command)
    app.command("lineage")(lineage_command)
    app.command("list")(list_command)
    app.command("show")(show_command)
