"""The options of the commands that can give a case a console."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.messages import tell
from ronna_hw.command_line.viewers_address import (
    BindOption,
    CertificateOption,
    KeyOption,
    viewers_address,
)

if TYPE_CHECKING:
    from procedures.cli.console.attaching import ConsoleRequest

__all__ = [
    "BindOption",
    "CertificateOption",
    "ConsoleOption",
    "ConsolePortOption",
    "KeyOption",
    "console_request",
]

ConsoleOption = Annotated[
    bool, typer.Option("--console", help="Serve a page on this computer that shows and operates the case.")
]
ConsolePortOption = Annotated[
    int, typer.Option(min=0, max=65535, help="Port of the page of --console; 0: any free one.")
]


def console_request(
    *, wanted: bool, port: int, bind: str | None, certificate: Path | None, key: Path | None
) -> ConsoleRequest | None:
    """What the options ask for. Raises PRO-040 where the console is not installed, CLI-001 for a slip."""
    if not wanted:
        if port or bind or certificate or key:
            raise UsageMistake("--console-port, --bind, --certificate and --key go with --console")
        return None
    from procedures.cli.console.attaching import ConsoleRequest, check_console, check_port

    check_console()
    check_port(port)
    viewers = viewers_address(bind, certificate, key)
    for warning in () if viewers is None else viewers.check():
        tell(f"warning: {warning}")
    return ConsoleRequest(port, viewers)
