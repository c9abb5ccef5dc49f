"""OpenIGTLink server beside a run, in a process of its own. Its failure never stops the case."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.live.errors import ADDRESS_UNUSABLE
from procedures.runs.observers import RunObservers
from ronna_hw.errors import RonnaError
from ronna_hw.host.child_process import ChildProcess, command
from ronna_hw.host.process import describe_exit

if TYPE_CHECKING:
    from procedures.engine.engine import Engine

READY_S = 45.0  # host time; as for a console
END_S = 3.0  # host time in which it tells its clients that the case has ended
EXAMPLE = "127.0.0.1:18944"


@dataclass(frozen=True)
class LinkAddress:
    """Address and port at which a run is served."""

    host: str
    port: int

    @classmethod
    def parse(cls, text: str) -> LinkAddress:
        """Read HOST:PORT. Raises LIV-011."""
        host, _, port = text.rpartition(":")
        if not host or not port.isdecimal() or int(port) > 65535:
            raise ADDRESS_UNUSABLE(f"--openigtlink {text!r} is no address", expected=f"such as {EXAMPLE}")
        return cls(host.strip("[]"), int(port))

    def check(self) -> None:
        """Raise LIV-011 if nothing can listen there, before any part of the case is opened."""
        try:
            family, kind, protocol, _, address = socket.getaddrinfo(
                self.host, self.port, type=socket.SOCK_STREAM
            )[0]
            with socket.socket(family, kind, protocol) as probe:
                probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
                probe.bind(address)
        except OSError as error:
            raise ADDRESS_UNUSABLE(
                f"--openigtlink {self.host}:{self.port} cannot be used", got=error.strerror
            ) from error


@contextlib.contextmanager
def with_openigtlink(observers: RunObservers, folder: Path, address: LinkAddress) -> Iterator[RunObservers]:
    """Serve a case from when its engine is open to the end of the block. A failure is only said."""
    with contextlib.ExitStack() as stack:

        def opened(engine: Engine) -> None:
            observers.opened(engine)
            server = _Server(folder, address, observers.announce)
            stack.callback(server.close)
            server.await_ready()

        yield replace(observers, opened=opened)


class _Server:
    """The server's process, watched."""

    def __init__(self, folder: Path, address: LinkAddress, say: Callable[[str], None]) -> None:
        self._say = say
        self._ending = self._is_ready = False
        arguments = (
            "openigtlink",
            str(folder.resolve()),
            "--listen",
            address.host,
            "--port",
            str(address.port),
        )
        self._child = ChildProcess(
            "the OpenIGTLink server",
            command("procedures.cli.link", *arguments),
            timeout_s=None,
            on_message=self._pass_on,
        )

    def await_ready(self) -> None:
        """Wait until clients may connect, or until it has failed: a short case would be over before."""
        try:
            self._say(f"READY {json.dumps(self._child.await_ready(READY_S))}")
        except (RonnaError, ValueError) as error:
            self._say(f"no OpenIGTLink: {error}")
            return
        self._is_ready = True
        threading.Thread(target=self._watch, name="openigtlink", daemon=True).start()

    def close(self) -> None:
        """Let it end with the case, whose feed has ended. Never raises."""
        self._ending = True
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._child.process.wait(END_S)
        self._child.stop()

    def _watch(self) -> None:
        if self._child.process.wait() and not self._ending:  # it ends well with the feed of the case
            how = describe_exit(self._child.process.returncode)
            self._say(
                f"the OpenIGTLink server has ended ({how}); the case goes on, ronna-link starts another"
            )

    def _pass_on(self, line: str) -> None:
        if (self._is_ready and not self._ending) or line.startswith("warning:"):
            self._say(line)
