"""The console's process, fed with events and heard for orders; whatever happens to it, the case continues."""

from __future__ import annotations

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from procedures.cli.console.desk import Desk
from procedures.engine.events import EventStream
from procedures.engine.orders import LONGEST_BYTES, Reply, read_order
from ronna_hw.command_line.messages import tell, tell_address
from ronna_hw.errors import RonnaError
from ronna_hw.host.child_process import ChildProcess, command

if TYPE_CHECKING:
    from procedures.workcell import Workcell
    from ronna_hw.command_line.viewers_address import ViewersAddress

READY_S = 45.0  # host time; heavy imports, with what a busy computer leaves to a nice process
STALLED_S = 5.0  # host time in which it takes nothing: it counts as gone
BEAT_S = 0.25  # host time between two signs of life when nothing happens
BEAT = '{"beat":1}'
BETWEEN_SIGNALS_S = 0.05  # host time: signals are conflated to 20 Hz


class ConsoleLink:
    """One console for one run. Two threads of its own; neither holds up the engine."""

    def __init__(
        self,
        folder: Path,
        desk: Desk,
        port: int,
        say: Callable[[str], None] = tell,
        viewers: ViewersAddress | None = None,
    ) -> None:
        """Starts the process and does not wait for it; `port` 0 is any free one, `say` says its address."""
        self._desk = desk
        self._say = say
        self._ending = False
        self._writing = threading.Lock()
        self._feed: threading.Thread | None = None
        self._socket, theirs = socket.socketpair()
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, struct.pack("ll", int(STALLED_S), 0))
        with theirs:
            arguments = ["--feed", str(theirs.fileno()), "--port", str(port)]
            if viewers is not None:
                files = (str(viewers.certificate.resolve()), str(viewers.key.resolve()))
                arguments += ["--viewers", viewers.address, *files]
            arguments.append(str(folder.resolve()))
            self._child = ChildProcess(
                "console",
                command("console.serving", *arguments),
                timeout_s=None,
                inherited=(theirs.fileno(),),
            )
        self._answered = threading.Event()
        self._followed = threading.Event()
        self._over = threading.Event()
        self._start(self._await_ready, "console ready")
        self._start(self._beat_until_followed, "console beats")

    def follow(self, events: EventStream) -> None:
        """Send everything that happens from now on."""
        self._followed.set()
        self._feed = self._start(lambda: self._send_all(events), "console feed")

    def await_ready(self) -> None:
        """Wait, as long as it may take at most, until the console serves or is known not to.

        It starts alongside the theatre; a case that does not wait may be over before anybody can look at it.
        """
        self._answered.wait(READY_S)

    def show_looks(self, workcell: Workcell) -> None:
        """Send what the stereo head sees from now on."""
        from procedures.cli.console.live_pictures import LivePictures

        pictures = LivePictures(self._send, self._over)
        workcell.on_look = pictures.look
        self._start(pictures.send_all, "console pictures")

    def close(self) -> None:
        """The run has ended: let the console say so, and end it. Never raises."""
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
            self._gone()
            self._answered.set()
            return
        tell_address(ready, self._say)
        self._answered.set()
        self._hear()

    def _hear(self) -> None:
        """Take orders until the console ends."""
        with contextlib.suppress(OSError, ValueError), self._socket.makefile("rb") as lines:
            while line := lines.readline(LONGEST_BYTES + 1):
                try:
                    order = read_order(line)
                except ValueError:
                    continue  # the console's own side has refused it
                self._send(Reply(nonce=order.nonce, refused=self._desk.take(order)).model_dump_json())
        self._gone()

    def _beat_until_followed(self) -> None:
        """A theatre that is being opened has no events yet; its console hears that this program lives."""
        while not self._followed.wait(BEAT_S) and self._send(BEAT):
            pass

    def _send_all(self, events: EventStream) -> None:
        reader, ended = events.subscribe(), False
        while not ended:
            reader.wait(BEAT_S)
            self._desk.look()
            batch = reader.read(0.0)
            ended = batch.ended
            lines = [f'{{"event":{event.model_dump_json()}}}' for event in batch.events]
            if not self._send("\n".join(lines or [BEAT])):
                return
            if all(event.what.signal for event in batch.events):
                time.sleep(BETWEEN_SIGNALS_S)

    def _send(self, text: str) -> bool:
        try:
            with self._writing:
                self._socket.sendall(text.encode() + b"\n")
        except OSError:
            if not self._ending:
                self._child.process.kill()  # it takes nothing: better none than one that shows the past
            return False
        return True

    def _gone(self) -> None:
        if not self._desk.gone:
            self._desk.leave()
            if not self._ending:
                self._say("the console has ended; this terminal operates the case")
