"""Gives a case a browser console for as long as it lasts."""

from __future__ import annotations

import contextlib
import importlib.util
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.case.opening import Watcher
from procedures.cli.console.desk import Desk
from procedures.cli.console.link import ConsoleLink
from procedures.cli.console.pilot import Pilot
from procedures.engine.errors import ConsoleMissing
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.messages import tell

if TYPE_CHECKING:
    from procedures.engine.engine import Engine
    from ronna_hw.command_line.viewers_address import ViewersAddress

LOOPBACK = "127.0.0.1"
NEEDED = ("nicegui", "skimage")  # of the extra `console`


@dataclass(frozen=True)
class ConsoleRequest:
    """A console at a port of the loopback address; 0 is any free one. `viewers` have an address of theirs."""

    port: int = 0
    viewers: ViewersAddress | None = None


def check_console() -> None:
    """Raise PRO-040 where the console's libraries are not installed."""
    if missing := [name for name in NEEDED if importlib.util.find_spec(name) is None]:
        raise ConsoleMissing(f"the console needs {' and '.join(missing)}")


def check_port(port: int) -> None:
    """Raise CLI-001 for a port that is taken, before anything of the case is opened."""
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((LOOPBACK, port))
        except OSError as error:
            raise UsageMistake(
                f"--console-port {port} cannot be used: {error.strerror}",
                action="Give another port, or omit the option to use any free one.",
            ) from error


@contextlib.contextmanager
def attached(
    pilot: Pilot, folder: Path, console: ConsoleRequest, say: Callable[[str], None] = tell
) -> Iterator[ConsoleLink]:
    """Serve the console of a run while the block runs; `say` says its address."""
    link = ConsoleLink(folder, pilot.desk, console.port, say, console.viewers)
    try:
        yield link
    finally:
        link.close()


@contextlib.contextmanager
def with_console(
    watcher: Watcher, folder: Path, console: ConsoleRequest, *, waits: bool
) -> Iterator[Watcher]:
    """The watcher of a case that runs to its end, with a console.

    With `waits`, nothing is done until someone has taken the operator's seat.
    """
    pilot = Pilot(Desk(waits=waits), runs=True)
    with attached(pilot, folder, console, watcher.room_open) as link:

        def opened(engine: Engine) -> None:
            watcher.opened(engine)
            pilot.attach(engine)
            link.follow(engine.events)
            link.show_looks(engine.setting.workcell)
            link.await_ready()

        yield replace(watcher, opened=opened, pilot=pilot)
