"""The options of the commands that can give a case a console."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from ronna_hw.command_line.errors import UsageMistake

if TYPE_CHECKING:
    from procedures.cli.console.attaching import ConsoleRequest

ConsoleOption = Annotated[
    bool, typer.Option("--console", help="Serve a page on this computer that shows and operates the case.")
]
ConsolePortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="Port of the page of --console; 0: any free one.")
]


def console_request(*, wanted: bool, port: int) -> ConsoleRequest | None:
    """What the options ask for. Raises PRO-040 where the console is not installed, CLI-001 for a slip."""
    if not wanted:
        if port:
            raise UsageMistake("--console-port goes with --console")
        return None
    from procedures.cli.console.attaching import ConsoleRequest, check_console

    check_console()
    return ConsoleRequest(port)
