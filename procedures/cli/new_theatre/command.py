"""`ronna-procedure new-theatre`."""

from __future__ import annotations

import sys
import tomllib
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.options import require_new

if TYPE_CHECKING:
    from procedures.cli.new_theatre.searching import DeviceTable
    from ronna_hw.endpoints import Endpoint

NO_CARD = "none"
REHEARSAL = "REHEARSAL: EVERY DEVICE IS ON THIS COMPUTER"  # where only simulators can be


def new_theatre(
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="New file.")] = Path("theatre.toml"),
    name: Annotated[str | None, typer.Option(help="Name of the theatre [default: the file's].")] = None,
    interface: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Network card to search for cameras and controller, by name or address; repeatable. "
            "No other is used.",
        ),
    ] = None,
    serial: Annotated[
        list[str] | None,
        typer.Option(
            metavar="LINE",
            help="Line to probe for a tracker: a path or an endpoint; repeatable "
            "[default: every serial port].",
        ),
    ] = None,
    controller: Annotated[
        list[str] | None,
        typer.Option(metavar="HOST[:PORT]", help="The robot's controller, instead of a search; repeatable."),
    ] = None,
    stream: Annotated[
        str | None,
        typer.Option(
            metavar="udp://HOST:PORT",
            help="Where the robot's telegrams arrive [default: as in the controller's Ethernet file].",
        ),
    ] = None,
    assistant: Annotated[
        str | None,
        typer.Option(metavar="HOST[:PORT]", help="The controller of a second arm, the assistant; else none."),
    ] = None,
    assistant_stream: Annotated[
        str | None,
        typer.Option(metavar="udp://HOST:PORT", help="Where the telegrams of that arm arrive, likewise."),
    ] = None,
    left: Annotated[
        str | None, typer.Option(metavar="CAMERA", help="The left camera, by serial number or address.")
    ] = None,
    right: Annotated[str | None, typer.Option(metavar="CAMERA", help="The right camera, likewise.")] = None,
    records: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Copy the records of mount, tools and cell from another theatre file or part of one.",
        ),
    ] = None,
    option: Annotated[
        list[str] | None,
        typer.Option(
            metavar="TABLE.KEY=VALUE", help="Option of a driver, such as stereo.exposure_us=1500; repeatable."
        ),
    ] = None,
    clock: Annotated[str, typer.Option(help="Source of time; to rehearse, that of a simulated theatre.")] = (
        "host:"
    ),
    check: Annotated[bool, typer.Option(help="Check the file as ronna-procedure doctor does.")] = True,
    as_json: terminal.JsonOption = False,
) -> None:
    """Create the theatre file of your own devices: find them, write every option, check the file.

    Only the given lines, addresses and network cards are probed; nothing moves. At a terminal, missing values
    are asked for. Exit codes: 0 written, and every device is there and ready; 2 usage; 4 written, and a
    device was not found or is not ready; 130 interrupted.
    """
    from procedures.cli.new_theatre import searching, writing
    from ronna_hw.config import parse_theatre
    from ronna_hw.devices.probing import Search
    from ronna_hw.errors import EXIT_NOT_FOUND
    from ronna_hw.records import write_atomically
    from ronna_hw.registry import load_finders
    from ronna_hw.theatre_kind import is_simulated

    finders = tuple(load_finders().values())
    with searching.Mistakes() as mistakes:
        mistakes.collect(require_new, (out,))
        mistakes.collect(_require_short, () if name is None else (name,))
        cards = mistakes.collect(lambda name: searching.find_interfaces([name]), interface or ())

        def endpoints(option: str, *given: str | None) -> tuple[Endpoint, ...]:
            texts = [one for one in given if one is not None]
            return mistakes.collect(partial(searching.endpoint_of, option), texts)

        lines = endpoints("--serial", *searching.lines(serial))
        controllers = endpoints("--controller", *(controller or ()))
        streams = endpoints("--stream", stream)
        assistants = endpoints("--assistant", assistant)
        assistant_streams = endpoints("--assistant-stream", assistant_stream)
        mistakes.collect(partial(searching.require_another, "--assistant", controllers), assistants)
        mistakes.collect(partial(searching.require_another, "--assistant-stream", streams), assistant_streams)
        endpoints("--clock", clock)
        examples = searching.example_tables(finders, Search())
        if assistants:
            examples += searching.as_assistant(examples)
        writing.with_options(examples, option or (), mistakes)
    copied = writing.CopiedRecords() if records is None else writing.read_records(records)
    if interface is None:
        cards = (searching.find_interfaces(_ask_interfaces()),)
    search = Search(
        interfaces=tuple(dict.fromkeys(card for each in cards for card in each)),
        lines=lines,
        controllers=controllers,
        stream=next(iter(streams), None),
    )
    with terminal.progress_bar("looking for the devices") as advance:
        found = searching.search_all(finders, search, (left, right), _choose, advance)
    if assistants:
        second = Search(controllers=assistants, stream=next(iter(assistant_streams), None))
        with terminal.progress_bar("looking for the assistant") as advance:
            found += searching.find_assistant(finders, second, _choose, advance)
    with searching.Mistakes() as mistakes:  # what fits no device as it was found
        found = writing.with_options(writing.with_tools(found, copied.tools), option or (), mistakes)
    name = name or out.stem
    text = writing.theatre_text(name, found, clock, copied.tables)
    if is_simulated(parse_theatre(tomllib.loads(text), (records or out).name)):
        text = writing.theatre_text(name, found, clock, copied.tables, REHEARSAL)
    write_atomically(out, text.encode(), exclusive=True)
    ready = _report_devices(out, found, check=check, as_json=as_json)
    if not ready:
        raise typer.Exit(EXIT_NOT_FOUND)


def _require_short(name: str) -> None:
    """Raise CLI-001 for a name of a theatre that no line of a report has room for."""
    from ronna_hw.devices.lifecycle import LONGEST_NAME

    if len(name) > LONGEST_NAME:
        raise UsageMistake(
            f"--name has {len(name)} characters", expected=f"at most {LONGEST_NAME}", action="Shorten it."
        )


def _report_devices(out: Path, found: Sequence[DeviceTable], *, check: bool, as_json: bool) -> bool:
    """Report the devices found and the doctor's verdict; return whether all are present and ready."""
    from procedures.cli.doctor.report import examine, show_findings

    for one in found:
        addresses = ", ".join(one.proposal.endpoints.values())
        what = f"{one.proposal.what} at {addresses}" if one.is_found else one.proposal.absent or "not found"
        terminal.tell(f"{one.table}: {what}")
    complete = all(one.is_found for one in found)
    if not check:
        terminal.tell(f"{out} was written; check it with ronna-procedure doctor --config {out}")
        return complete
    with terminal.progress_bar("checking the file") as progress:
        report = examine(out, progress=progress)
    show_findings(report, as_json=as_json)
    terminal.tell(f"{out} was written{'' if complete else '; it lists what is missing'}")
    return complete and all(one.well for one in report.devices)


def _ask_interfaces() -> list[str]:
    """Ask which networks to search, repeating after invalid input; return none without a terminal."""
    from ronna_hw.host.network import interfaces

    if not terminal.on_terminal(sys.stdin):
        terminal.tell("no --interface: no network is searched for cameras or controller")
        return []
    known = ", ".join(f"{each.name} ({each.address})" for each in interfaces())
    question = f"Network cards to search, of {known}"
    chosen: list[str] = typer.prompt(question, default=NO_CARD, value_proc=_parse_cards, err=True)
    return chosen


def _parse_cards(answer: str) -> list[str]:
    from procedures.cli.new_theatre import searching

    names = [] if answer == NO_CARD else answer.replace(",", " ").split()
    try:
        searching.find_interfaces(names)
    except UsageMistake as mistake:
        raise typer.BadParameter(f"{mistake.what}; expected {mistake.expected}") from mistake
    return names


def _choose(question: str, words: Sequence[str]) -> int | None:
    """Ask the user to choose; return the index, or None without a terminal."""
    if not terminal.on_terminal(sys.stdin):
        return None
    for number, one in enumerate(words, start=1):
        terminal.tell(f"{number}: {one}")
    while True:
        answer: int = typer.prompt(question, type=int, err=True)
        if 1 <= answer <= len(words):
            return answer - 1
