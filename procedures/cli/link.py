"""`ronna-link`: links of a running case to other programs, which see it and cannot move it."""

from __future__ import annotations

import ronna_hw.command_line.early_interruption
import ronna_hw.host.process  # noqa: F401 - first of all: a parent that dies during the imports is still noticed

# isort: split
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, Option

from procedures.cli.runs.run_argument import require_run_folder
from ronna_hw.command_line import terminal

if TYPE_CHECKING:
    from procedures.live.openigtlink.server import ServerOptions

PORT = 18944  # of OpenIGTLink
RATE_HZ = 30.0
LOOPBACK = "127.0.0.1"
LISTENING_WARNING = "anyone who can reach {} sees this patient's poses, plan and CT; it gives no control"
SWITCH_S = 0.0005  # between threads: an image that is made in one delays poses by no more

app = terminal.command_group(
    "ronna-link",
    "Links of a running case to other programs, which can only watch it.",
    example="ronna-link openigtlink runs/20261126T165631-s7-5191",
)


@app.callback()
def link() -> None:
    """Links of a running case to other programs, which can only watch it."""


@app.command("openigtlink")
def openigtlink_command(
    run: Annotated[
        Path,
        Argument(metavar="RUN", help="Folder of a run whose case is running.", callback=require_run_folder),
    ],
    port: Annotated[int, Option(min=0, max=65535, help="TCP port; 0: any free one.")] = PORT,
    listen: Annotated[
        str, Option(metavar="ADDRESS", help="Address to listen on, if not only this computer may connect.")
    ] = LOOPBACK,
    rate: Annotated[
        float, Option(min=0.1, max=1000.0, help="Most messages of one pose per second.")
    ] = RATE_HZ,
    header_version: Annotated[
        int,
        Option(
            min=1,
            max=2,
            help="Header for clients that have not sent one: 2 has metadata; peers of protocol 2 misread it.",
        ),
    ] = 1,
) -> None:
    """Serve a running case to 3D Slicer, PLUS and other OpenIGTLink clients, until it ends.

    Prints READY with the address. Clients get poses, states, spheres and plan, and on request pictures and
    the CT; nothing that they send moves or changes anything. Exit codes: 0 the case has ended, 2 the address
    cannot be used, 4 no case is running in RUN.
    """
    from procedures.live.openigtlink.server import ServerOptions
    from procedures.runs.case import case_folder
    from procedures.runs.request import CaseProcedure
    from procedures.runs.request_file import read_request

    procedure = read_request(run).procedure
    ct = case_folder(procedure, run) / "ct" if isinstance(procedure, CaseProcedure) else None
    if not _is_loopback(listen):
        terminal.tell(f"warning: {LISTENING_WARNING.format(listen)}")
    _serve(run, ServerOptions(listen, port, rate, header_version, ct))


def _is_loopback(host: str) -> bool:
    from ipaddress import ip_address

    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _serve(run: Path, options: ServerOptions) -> None:
    import asyncio

    from procedures.live.feed_reader import read_feed
    from procedures.live.openigtlink.server import LinkServer

    def ready(host: str, port: int) -> None:
        address = f"[{host}]:{port}" if ":" in host else f"{host}:{port}"
        sys.stdout.write(f"READY {json.dumps({'openigtlink': address, 'run': run.resolve().name})}\n")
        sys.stdout.flush()

    async def serve() -> None:
        await LinkServer(options, terminal.tell).serve(read_feed(run), ready)

    sys.setswitchinterval(SWITCH_S)
    asyncio.run(serve())


def main() -> None:
    terminal.run(app)


if __name__ == "__main__":
    main()
