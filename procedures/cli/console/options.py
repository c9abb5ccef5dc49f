"""The options of the commands that can give a case a console."""

from __future__ import annotations

from dataclasses import dataclass
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
    from procedures.runs.console_link import ConsoleRequest


@dataclass(frozen=True)
class ConsoleOptions:
    """A page that shows and operates the case, and whether viewers at other computers may see it."""

    console: Annotated[
        bool,
        typer.Option("--console", help="Serve a page on this computer that shows and operates the case."),
    ] = False
    console_port: Annotated[
        int, typer.Option(min=0, max=65535, help="Port of the page of --console; 0: any free one.")
    ] = 0
    bind: BindOption = None
    certificate: CertificateOption = None
    key: KeyOption = None

    def request(self) -> ConsoleRequest | None:
        """What they ask for. Raises PRO-040 where the console is not installed, CLI-001 for a slip."""
        if not self.console:
            if self.console_port or self.bind or self.certificate or self.key:
                raise UsageMistake("--console-port, --bind, --certificate and --key require --console")
            return None
        from procedures.runs.console_link import ConsoleRequest, check_console, check_port

        check_console()
        check_port(self.console_port)
        viewers = viewers_address(self.bind, self.certificate, self.key)
        for warning in () if viewers is None else viewers.check():
            tell(f"warning: {warning}")
        return ConsoleRequest(self.console_port, viewers)
