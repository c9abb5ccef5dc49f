"""Command definitions for existing runs. Implementations are imported on first call."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

from procedures.cli.case.options import ConsoleOptions
from procedures.cli.runs.page_commands import compare_command, sheet_command
from procedures.cli.runs.run_argument import FolderOption, RunArgument, require_run_folder
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.options import require_output_folder, with_option_records
from ronna_hw.command_line.terminal import JsonOption, print_json, tell
from ronna_hw.text import escape_controls


def _refuse_asking(given: bool) -> None:
    """Raise CLI-001 for an option that a resumed run has from its start."""
    if given:
        raise UsageMistake(
            "--ask is chosen when a run is begun",
            action="Omit it: a run begun with --ask asks again, any other is answered by its script.",
        )


AcceptOption = Annotated[
    bool, Option("--accept", help="Accept the findings without asking; in a simulated theatre only.")
]
AnswersOption = Annotated[Path | None, Option(help="TOML file that answers the questions of the case.")]


@with_option_records
def resume_command(
    run_folder: RunArgument,
    accept: AcceptOption = False,
    answers: AnswersOption = None,
    *,
    _ask: Annotated[
        bool,
        Option(
            "--ask",
            help="Refused: a run has it from its start.",
            hidden=True,
            is_eager=True,
            callback=_refuse_asking,
        ),
    ] = False,
    console: ConsoleOptions,
    as_json: JsonOption = False,
) -> None:
    """Resume a run that was killed, left or interrupted.

    Nothing moves until devices, tool, calibrations, CT, plan, patient and robot base have been re-read,
    compared with the record and accepted. With --console, the operator in the seat accepts; --accept
    continues without one. A resumed run keeps the strategy, the localizer and the matcher of its start; one
    begun with --ask asks again, and one begun by step goes on by commands, unless with --console or --json.
    Exit codes: 0 finished, 3 the run was changed, 8 not resumed.
    """
    from procedures.cli.runs.resume import resume

    resume(run_folder, accept=accept, answers=answers, as_json=as_json, console=console.request())


def home_command(
    run_folder: RunArgument,
    accept: AcceptOption = False,
    answers: AnswersOption = None,
    as_json: JsonOption = False,
) -> None:
    """Send the arm of an ended run home, after any instrument has been removed.

    Nothing moves until devices and tool have been compared with the record and accepted. The guide retreats
    along its axis first. The run is unchanged and can be resumed. Exit codes: 0 the arm is home, 8 not
    accepted, others as in `run`.
    """
    from procedures.cli.runs.resume import home

    home(run_folder, accept=accept, answers=answers, as_json=as_json)


def acknowledge_command(
    run_folder: Annotated[Path | None, Argument(metavar="[RUN]", help="Folder of a run.")] = None,
    config: Annotated[Path | None, Option(metavar="THEATRE", help="Theatre file, without a run.")] = None,
    by: Annotated[
        str | None,
        Option(metavar="NAME", help="Name of the person acknowledging; prompted for at a terminal."),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Recover devices in fault once the cause is gone; moves nothing.

    The journal of the run records who did it. Exit codes: 0 nothing is in fault any more, 3 the cause
    persists or nobody is named, 4 a device is not found, others as in `run`.
    """
    if (run_folder is None) == (config is None):
        raise UsageMistake(
            "name either a run or, with --config, a theatre file",
            action="acknowledge RUN recovers the devices of a run, --config THEATRE those of a theatre file.",
        )
    from procedures.cli.runs.resume import acknowledge_run, acknowledge_theatre

    if run_folder is not None:
        acknowledge_run(require_run_folder(run_folder), by, as_json=as_json)
    elif config is not None:
        acknowledge_theatre(config, by, as_json=as_json)


def verify_command(run_folder: RunArgument, as_json: JsonOption = False) -> None:
    """Find every file of a run that was changed, removed or added.

    Exit codes: 0 intact, 3 something differs, 9 intact as far as can be said: the run was killed and resumed,
    and what had no seal in between could have been changed.
    """
    from procedures.cli.runs.evidence import verify

    verify(run_folder, as_json=as_json)


def lineage_command(
    run_folder: RunArgument, mermaid: Annotated[bool, Option("--mermaid", help="As a Mermaid chart.")] = False
) -> None:
    """Draw the results of a run and what each was made from; superseded ones are marked."""
    from procedures.cli.runs.showing import draw_lineage

    draw_lineage(run_folder, as_mermaid=mermaid)


def list_command(
    folder: Annotated[Path, Argument(metavar="[DIR]", help="Folder of runs.")] = Path("runs"),
    as_json: JsonOption = False,
) -> None:
    """List the runs of a folder and how each ended."""
    from procedures.cli.runs.showing import list_runs

    list_runs(folder, as_json=as_json)


def show_command(run_folder: RunArgument, as_json: JsonOption = False) -> None:
    """Show what a run did, how it ended, the errors at its targets, and what to do next."""
    from procedures.cli.runs.showing import show_run

    show_run(run_folder, as_json=as_json)


def report_command(run_folder: RunArgument, out: FolderOption = None, as_json: JsonOption = False) -> None:
    """Rebuild the report of a run from its folder: report.html, with pictures and data in report/.

    The journal is not continued, and a run without a seal stays without one: what nothing vouches for is
    named.
    """
    from procedures.reporting.run_reading import read_for_report
    from procedures.reporting.run_summary import read_two_arms
    from procedures.runs.finishing import rebuild_report

    path = rebuild_report(run_folder, out)
    if as_json:
        reading = read_for_report(run_folder, every_file=False)
        print_json({"report": str(path), **read_two_arms(reading).model_dump(mode="json")})
    else:
        sys.stdout.write(f"{escape_controls(str(path))}\n")


def export_command(
    run_folder: RunArgument,
    out: FolderOption = None,
    identity_from: Annotated[
        Path | None,
        Option(
            "--identity-from",
            metavar="CT",
            help="Folder of the run's CT: its patient and study go into the DICOM objects. Needs --out.",
        ),
    ] = None,
    with_scan: Annotated[
        bool,
        Option("--with-scan", help="Add the scan of the skin as PLY and VTP: it shows the patient's face."),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Write plan, spheres, registrations, reached lines and errors as Slicer markups, CSV, JSON and DICOM
    objects, without patient identity unless with --identity-from.

    Written to the run's folder `export` by default. A run that ended early is exported as far as it came;
    export.json says what is absent, and what was left out to protect the patient. An archive files the
    objects with --identity-from beside the CT.
    """
    from procedures.exchange.run_export import export_run
    from procedures.runs.simulated_theatre import find_truth

    folder = run_folder / "export"
    if identity_from is not None and (out is None or out.resolve().is_relative_to(run_folder.resolve())):
        raise UsageMistake(
            "--identity-from needs a folder outside the run: run folders name no patient",
            expected="--out DIR",
            got="none" if out is None else str(out),
            action="Name a folder for objects that are meant for an archive, and treat it as patient data.",
        )
    if out is not None and out.resolve() != folder.resolve():
        require_output_folder(out)
        folder = out
    exported = export_run(run_folder, folder, find_truth, identity_from, with_scan=with_scan)
    if exported.study is not None:
        tell(f"patient: {exported.study.describe()}")
    if as_json:
        files = [str(path) for path in exported.files]
        print_json({"files": files, "absent": dict(exported.absent), "withheld": dict(exported.withheld)})
        return
    for path in exported.files:
        tell(str(path))
    for what, why in exported.absent.items():
        tell(f"not in this run: {what} ({why})")
    for what, why in exported.withheld.items():
        tell(f"left out: {what} ({why})")


def watch_command(
    run_folder: RunArgument,
    as_json: Annotated[bool, Option("--json", help="One event per line, as JSON.")] = False,
) -> None:
    """Follow a run from another terminal: its present state, then what happens, until it ends.

    Reads RUN/events.jsonl and changes nothing; any number of viewers may watch.
    """
    from procedures.cli.runs.showing import watch

    watch(run_folder, as_json=as_json)


def replay_command(run_folder: RunArgument, as_json: JsonOption = False) -> None:
    """Recompute every result of a run from its recorded readings and compare. Touches no device.

    Exit codes: 0 everything is equal, 1 a record differs or cannot be recomputed, 3 the run
    was changed.
    """
    from procedures.cli.runs.evidence import replay_run

    replay_run(run_folder, as_json=as_json)


def bytes_command(
    run_folder: RunArgument,
    link: Annotated[str | None, Option(help="A link, or a device for all its links.")] = None,
    from_s: Annotated[float | None, Option("--from", help="Theatre time to start at, s.")] = None,
    to_s: Annotated[float | None, Option("--to", help="Theatre time to end at, s.")] = None,
    as_json: Annotated[bool, Option("--json", help="One JSON object per line.")] = False,
) -> None:
    """Print the traffic on a run's links: time, direction, bytes in hex and as text.

    The text is a hex dump that text2pcap reads: text2pcap -D -t ISO -l 147 - link.pcapng
    """
    from procedures.cli.runs.evidence import print_bytes

    print_bytes(run_folder, link, from_s, to_s, as_json=as_json)


def raw_command(
    run_folder: RunArgument,
    out: Annotated[Path, Option("--out", metavar="DIR", help="New output folder.")],
    as_json: JsonOption = False,
) -> None:
    """Write the device readings of a run as files: pictures as PNG, tracker frames and arm states as CSV.

    Pictures show what the cameras saw. They are in no export: only this command extracts them from a run, and
    it refuses a run that was changed after it ended.
    """
    from procedures.exchange.raw_readings import write_raw
    from ronna_hw.evidence.inspection import inspect_run

    inspect_run(run_folder).require_unchanged()
    folder, whole = write_raw(run_folder, out)
    if as_json:
        print_json({"folder": str(folder), "whole": whole})
        return
    tell(str(folder) if whole else f"{folder}: the first 2 GB")


def recover_log_command(
    log: Annotated[Path, Argument(metavar="LOG", help="A run, for all its logs, or one MCAP file.")],
    out: Annotated[
        Path | None, Option("--out", metavar="FILE", help="The copy; by default in the run's folder export.")
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Copy the log of a run that was killed, with the index and the sums that its end would have added.

    The log itself stays as it is. Of a cut log everything up to the cut is recovered.
    """
    from procedures.cli.runs.recovering import recover_logs

    recover_logs(log, out, as_json=as_json)


COMMANDS: dict[str, Callable[..., None]] = {
    "resume": resume_command,
    "home": home_command,
    "acknowledge": acknowledge_command,
    "verify": verify_command,
    "lineage": lineage_command,
    "list": list_command,
    "show": show_command,
    "report": report_command,
    "compare": compare_command,
    "sheet": sheet_command,
    "export": export_command,
    "watch": watch_command,
    "replay": replay_command,
    "bytes": bytes_command,
    "raw": raw_command,
    "recover-log": recover_log_command,
}


def add_commands(app: typer.Typer) -> None:
    """Add the run commands to an application."""
    for name, command in COMMANDS.items():
        app.command(name)(command)
