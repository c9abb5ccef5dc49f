"""Link to the console process: events out, orders in. A console failure never stops the case."""

from __future__ import annotations

import base64
import contextlib
import importlib.util
import socket
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.engine.errors import CONSOLE_MISSING
from procedures.engine.events import Event, EventStream, Questioned
from procedures.runs.observers import RunObservers
from procedures.runs.operator_station import OperatorStation
from procedures.runs.order_executor import OrderExecutor
from procedures.runs.orders import LONGEST_BYTES, OrderReply, read_order
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.messages import tell, tell_address
from ronna_hw.errors import RonnaError
from ronna_hw.host.child_process import ChildProcess, command

if TYPE_CHECKING:
    from procedures.engine.engine import Engine
    from procedures.workcell.stereo_look import PicturedLook
    from ronna_hw.command_line.viewers_address import ViewersAddress

READY_S = 45.0  # host time; heavy imports, with what a busy computer leaves to a nice process
STALLED_S = 5.0  # host time in which it takes nothing: it counts as gone
BEAT_S = 0.25  # host time between two signs of life when nothing happens
BEAT = '{"beat":1}'
SIGNAL_PERIOD_S = 0.05  # host time: signals are conflated to 20 Hz
PICTURE_PERIOD_S = 0.5  # host time from one picture to the next: drawing takes some ten milliseconds
HEIGHT_PX = 240
LOOPBACK = "127.0.0.1"
REQUIRED_MODULES = ("nicegui", "skimage")  # of the extra `console`


@dataclass(frozen=True)
class ConsoleRequest:
    """Console options: loopback port (0 for any free one) and an optional address for remote viewers."""

    port: int = 0
    viewers: ViewersAddress | None = None


class ConsoleLink:
    """Link between one run and one console. Its threads never block the engine."""

    def __init__(
        self,
        folder: Path,
        station: OperatorStation,
        console: ConsoleRequest,
        say: Callable[[str], None] = tell,
    ) -> None:
        """Start the console without waiting for it; `say` announces its address."""
        self._station = station
        self._say = say
        self._ending = False
        self._writing = threading.Lock()
        self._feed: threading.Thread | None = None
        self._socket, child_socket = socket.socketpair()
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", int(STALLED_S), 0))
        with child_socket:
            arguments = ["--feed", str(child_socket.fileno()), "--port", str(console.port)]
            if (viewers := console.viewers) is not None:
                files = (str(viewers.certificate.resolve()), str(viewers.key.resolve()))
                arguments += ["--viewers", viewers.address, *files]
            arguments.append(str(folder.resolve()))
            self._child = ChildProcess(
                "console",
                command("console.serving", *arguments),
                timeout_s=None,
                inherited=(child_socket.fileno(),),
            )
        self._answered = threading.Event()
        self._followed = threading.Event()
        self._over = threading.Event()
        self._newest: PicturedLook | None = None
        self._look_arrived = threading.Event()
        self._start(self._await_ready, "console ready")
        self._start(self._beat_until_followed, "console beats")

    def follow(self, events: EventStream) -> None:
        """Start sending events to the console."""
        self._followed.set()
        self._feed = self._start(lambda: self._send_all(events), "console feed")

    def await_ready(self) -> None:
        """Wait until the console is ready or has failed.

        It starts alongside the theatre. Without this wait, a short case may be over before anybody sees it.
        """
        self._answered.wait(READY_S)

    def show(self, engine: Engine) -> None:
        """Start sending the events of an engine, and the stereo head's pictures."""
        self.follow(engine.events)
        engine.setting.workcell.on_look = self._keep_look
        self._start(self._send_pictures, "console pictures")

    def close(self) -> None:
        """Stop the console once it has shown the end of the run. Never raises."""
        self._ending = True
        self._followed.set()
        self._over.set()
        if self._feed is not None:
            self._feed.join(STALLED_S)
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_WR)
        with contextlib.suppress(Exception):
            self._child.process.wait(timeout=STALLED_S)
        self._child.stop()
        self._socket.close()

    def _start(self, work: Callable[[], None], name: str) -> threading.Thread:
        thread = threading.Thread(target=work, name=name, daemon=True)
        thread.start()
        return thread

    def _await_ready(self) -> None:
        try:
            ready = self._child.await_ready(READY_S)
        except (RonnaError, ValueError) as error:
            if not self._ending:
                self._say(f"no console: {error}")
            self._on_console_gone()
            self._answered.set()
            return
        tell_address(ready, self._say)
        if self._station.waits:
            self._say("the case waits until someone takes the operator's seat on that page")
        self._answered.set()
        self._take_orders()

    def _take_orders(self) -> None:
        """Process the console's orders until it exits."""
        with contextlib.suppress(OSError, ValueError), self._socket.makefile("rb") as lines:
            while line := lines.readline(LONGEST_BYTES + 1):
                try:
                    sent = read_order(line)
                except ValueError:
                    continue  # the console's own side has refused it
                self._send(OrderReply(nonce=sent.nonce, refused=self._station.take(sent)).model_dump_json())
        self._on_console_gone()

    def _beat_until_followed(self) -> None:
        """Send heartbeats to keep the console alive until the theatre is open and events are sent."""
        while not self._followed.wait(BEAT_S) and self._send(BEAT):
            pass

    def _send_all(self, events: EventStream) -> None:
        reader, ended = events.subscribe(), False
        while not ended:
            reader.wait(BEAT_S)
            self._station.free_silent_seat()
            batch = reader.read(0.0)
            ended = batch.ended
            lines = [line for event in batch.events for line in event_lines(event)]
            if not self._send("\n".join(lines or [BEAT])):
                return
            if all(event.what.signal for event in batch.events):
                time.sleep(SIGNAL_PERIOD_S)

    def _keep_look(self, seen: PicturedLook) -> None:
        """Keep the latest stereo pair to be sent, so that taking a look is not delayed."""
        self._newest = seen
        self._look_arrived.set()

    def _send_pictures(self) -> None:
        from procedures.workcell.stereo_look import pair_picture

        while not self._over.wait(PICTURE_PERIOD_S):
            if not self._look_arrived.is_set():
                continue
            self._look_arrived.clear()
            assert self._newest is not None
            content = base64.b64encode(pair_picture(self._newest, HEIGHT_PX)).decode()
            if not self._send(f'{{"pair":"{content}"}}'):
                return

    def _send(self, text: str) -> bool:
        try:
            with self._writing:
                self._socket.sendall(text.encode() + b"\n")
        except OSError:
            if not self._ending:
                self._child.process.kill()  # it takes nothing: better none than one that shows the past
            return False
        return True

    def _on_console_gone(self) -> None:
        if not self._station.gone:
            self._station.leave()
            if not self._ending:
                self._say("the console has ended; this terminal operates the case")


def event_lines(event: Event) -> Iterator[str]:
    """Encode an event for the console. The patient's identity goes ahead of it, as no event contains it."""
    if isinstance(event.what, Questioned) and event.what.identity is not None:
        yield f'{{"identity":{event.what.identity.model_dump_json()}}}'
    yield f'{{"event":{event.model_dump_json()}}}'


def check_console() -> None:
    """Raise PRO-040 if the libraries of the console are not installed."""
    if missing := [name for name in REQUIRED_MODULES if importlib.util.find_spec(name) is None]:
        raise CONSOLE_MISSING(f"the console needs {' and '.join(missing)}")


def check_port(port: int) -> None:
    """Raise CLI-001 if the port is unavailable, before any part of the case is opened."""
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
def with_console(
    observers: RunObservers, folder: Path, console: ConsoleRequest, *, waits: bool
) -> Iterator[RunObservers]:
    """Add a console to the observers of a case for the duration of the block.

    With `waits`, nothing is done until someone has taken the operator's seat.
    """
    executor = OrderExecutor(OperatorStation(waits=waits), runs=True)
    link = ConsoleLink(folder, executor.station, console, observers.announce)
    with contextlib.closing(link):

        def opened(engine: Engine) -> None:
            observers.opened(engine)
            executor.attach(engine)
            link.show(engine)
            link.await_ready()

        yield replace(observers, opened=opened, executor=executor)
