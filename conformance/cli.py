"""`ronna-conformance`: run the conformance suite on a driver and its device."""

from __future__ import annotations

import ronna_hw.command_line.early_interruption  # noqa: F401 - first of all: imports can be interrupted

# isort: split
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from ronna_hw.command_line.terminal import (
    JsonOption,
    on_terminal,
    print_json,
    print_table,
    progress_bar,
    run,
    tell,
)
from ronna_hw.errors import EXIT_DONE, EXIT_FAILED

if TYPE_CHECKING:
    from conformance.device_under_test import DeviceUnderTest
    from conformance.report import Report

app = typer.Typer(name="ronna-conformance", no_args_is_help=True, add_completion=False, rich_markup_mode=None)


@app.command(no_args_is_help=True)
def conformance(
    kind: Annotated[Literal["tracker", "robot", "stereo"], typer.Argument(help="What to test.")],
    sim: Annotated[bool, typer.Option("--sim", help="Start the simulator and test against it.")] = False,
    config: Annotated[Path | None, typer.Option(help="Test the device in this theatre file.")] = None,
    endpoint: Annotated[
        list[str] | None, typer.Option(help="Test the device at this URI, or NAME=URI for each of several.")
    ] = None,
    driver: Annotated[str | None, typer.Option(help="Entry point of the driver to test.")] = None,
    device: Annotated[str | None, typer.Option(help="Robot of the theatre file.")] = None,
    allow: Annotated[
        list[str] | None, typer.Option(help="Also run cases that require this: motion, destructive or output.")
    ] = None,
    only: Annotated[
        list[str] | None, typer.Option(help="Run only cases whose number starts with this, such as P or T2.")
    ] = None,
    confirmed_by: Annotated[
        str | None,
        typer.Option(
            help="Name of the person standing by an arm that is allowed to move; prompted for if not given."
        ),
    ] = None,
    report_file: Annotated[
        Path | None, typer.Option("--report", help="Write the full report to this file, as JSON.")
    ] = None,
    json: JsonOption = False,
) -> int:
    """Run the conformance suite on a driver and its device. Safe by default: no motion, no reset."""
    from conformance.report import run_suite
    from conformance.target import DeviceChoice, device_under_test, resolve_target
    from ronna_hw.records import write_atomically

    if report_file is not None:
        write_atomically(report_file, b"")  # fail before the run, not after it
    choice = DeviceChoice(sim, config, tuple(endpoint or ()), driver, device, tuple(allow or ()))
    target = resolve_target(kind, choice)
    suite = target.suite.only(only or [])
    with device_under_test(target) as dut:
        moving_cases = suite.list_moving_cases() if "motion" in dut.offers and not sim else []
        person = _require_confirmation(suite.motions, moving_cases, dut, confirmed_by) if moving_cases else ""
        with progress_bar(f"{kind} suite") as progress:
            report = run_suite(suite, dut, progress, confirmed_by=person)
    document = report.as_document()
    if report_file is not None:
        import json as json_module

        write_atomically(report_file, json_module.dumps(document, indent=1, allow_nan=False).encode())
    if json:
        print_json(document)
    else:
        _print_report(report)
    return EXIT_DONE if report.passed else EXIT_FAILED


def _require_confirmation(
    motions: str, moving_cases: list[str], dut: DeviceUnderTest, given: str | None
) -> str:
    """Return the name of the person who confirms the motion; raises CNF-005 if nobody does."""
    from conformance.errors import NotConfirmed

    where = dut.config.endpoint or ", ".join(dut.config.endpoints.values())
    tell(f"{dut.name} at {where} will be moved by {', '.join(moving_cases)}: {motions}.")
    name = given
    if name is None and on_terminal(sys.stdin):
        tell("Make sure that its reach is clear of persons and objects, and hold the emergency stop.")
        name = typer.prompt("Confirmed by", default="", show_default=False, err=True)
    if not name or not name.strip():
        raise NotConfirmed(f"motion of {dut.name} has not been confirmed", expected="a person's name")
    return name.strip()


def _print_report(report: Report) -> None:
    from conformance.case import CaseOutcome

    where = ", ".join(report.endpoints.values())
    identity = report.identity
    print_table(
        f"{report.suite}: {identity.vendor} {identity.model} {identity.serial} at {where}",
        ("case", "outcome", "behaviour", "reason"),
        [(r.number, r.outcome.value, r.statement, r.reason) for r in report.results],
    )
    counts = ", ".join(f"{report.count(outcome)} {outcome.value.lower()}" for outcome in CaseOutcome)
    tell(f"{report.suite} suite, driver {report.driver}: {counts}")


def main() -> None:
    run(app)


if __name__ == "__main__":
    main()
