"""Bare clients of the robot controller that know nothing of our driver, and a running controller."""

from __future__ import annotations

import re
import select
import socket
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from math import cos, pi
from xml.etree import ElementTree

from ronna_hw.host.child_process import ChildProcess, command
from sim.world.world import World

FREE = "tcp://127.0.0.1:0"
LIMIT_S = 30.0
ZERO = (0.0,) * 6
_IPOC = re.compile(rb"<IPOC>(\d+)</IPOC></Rob>$")
_DELAY = re.compile(rb'<Delay D="(\d+)"/>')


class RsiClient:
    """A bare client: one socket, answers when told."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.socket.settimeout(LIMIT_S)
        self.source: tuple[str, int] = ("", 0)
        self.last = b""

    @property
    def endpoint(self) -> str:
        return f"udp://127.0.0.1:{self.socket.getsockname()[1]}"

    @property
    def ipoc(self) -> int:
        found = _IPOC.search(self.last)
        assert found is not None
        return int(found.group(1))

    @property
    def late(self) -> int:
        found = _DELAY.search(self.last)
        assert found is not None
        return int(found.group(1))

    @property
    def axes_deg(self) -> list[float]:
        axes = ElementTree.fromstring(self.last).find("AIPos")
        assert axes is not None
        return [float(value) for value in axes.attrib.values()]

    def receive(self) -> bytes:
        self.last, self.source = self.socket.recvfrom(8192)
        return self.last

    def await_telegram(self) -> None:
        """Wait until the next telegram lies there; it is not read."""
        assert select.select([self.socket], [], [], LIMIT_S)[0], "no telegram came"

    def receive_newest(self) -> bytes:
        """The last of the telegrams that lie there; waits for one when there is none."""
        self.receive()
        while select.select([self.socket], [], [], 0.0)[0]:
            self.receive()
        return self.last

    def answer(self, axes_deg: Sequence[float] = ZERO, *, stop: int = 0, ipoc: int | None = None) -> None:
        attributes = " ".join(f'A{n}="{value:.6f}"' for n, value in enumerate(axes_deg, 1))
        stamp = self.ipoc if ipoc is None else ipoc
        text = f'<Sen Type="KROSHU"><Stop>{stop}</Stop><AK {attributes}/><IPOC>{stamp}</IPOC></Sen>'
        self.socket.sendto(text.encode(), self.source)

    def cycles(self, count: int, axes_deg: Sequence[float] = ZERO) -> None:
        for _ in range(count):
            self.receive()
            self.answer(axes_deg)

    def move(
        self, goal_deg: Sequence[float], cycles: int = 200, begin_deg: Sequence[float] = ZERO
    ) -> list[list[float]]:
        """From some corrections to others; the measured axes of every telegram."""
        seen = []
        for n in range(1, cycles + 1):
            share = 0.5 - 0.5 * cos(pi * n / cycles)
            self.receive()
            seen.append(self.axes_deg)
            self.answer([a + share * (b - a) for a, b in zip(begin_deg, goal_deg, strict=True)])
        return seen

    def move_axis(self, goal_deg: float, cycles: int = 200, begin_deg: float = 0.0) -> list[float]:
        """A1 from one correction to another; its measured angle of every telegram."""
        seen = self.move((goal_deg, *ZERO[1:]), cycles, (begin_deg, *ZERO[1:]))
        return [axes_deg[0] for axes_deg in seen]

    def try_cycle(self, axes_deg: Sequence[float]) -> bool:
        """A cycle, when there is one; False when the stream has ended."""
        self.socket.settimeout(0.5)
        try:
            self.receive()
        except TimeoutError:
            return False
        finally:
            self.socket.settimeout(LIMIT_S)
        if _IPOC.search(self.last):
            self.answer(axes_deg)
        return True

    def until_other_source(self, source: tuple[str, int]) -> None:
        """Receive until a telegram comes from another address; those of the old one are not answered."""
        for _ in range(1000):
            self.receive()
            if self.source != source:
                return
        raise AssertionError("no other source")

    def forget(self) -> None:
        """Throw away what has queued up."""
        self.socket.setblocking(False)
        try:
            while True:
                self.socket.recv(8192)
        except BlockingIOError:
            self.socket.settimeout(LIMIT_S)

    def quiet(self, duration_s: float) -> bool:
        """True when nothing comes for that long; what has queued up is read first."""
        self.socket.settimeout(duration_s)
        try:
            for _ in range(200):
                self.receive()
        except TimeoutError:
            return True
        finally:
            self.socket.settimeout(LIMIT_S)
        return False


class EkiClient:
    """A bare client of an EKI channel."""

    def __init__(self, endpoint: str, root: str) -> None:
        host, port = endpoint.removeprefix("tcp://").split(":")
        self.socket = socket.create_connection((host, int(port)), timeout=LIMIT_S)
        self._root = root.encode()
        self._buffer = b""
        self.segments: list[bytes] = []

    def read(self) -> ElementTree.Element:
        """The next whole telegram."""
        ending = re.compile(rb"</(?:" + self._root + rb")>")
        while True:
            found = ending.search(self._buffer)
            if found:
                text, self._buffer = self._buffer[: found.end()], self._buffer[found.end() :]
                return ElementTree.fromstring(text)
            data = self.socket.recv(65536)
            if not data:
                raise ConnectionResetError
            self.segments.append(data)
            self._buffer += data

    def until(self, accepts: Callable[[ElementTree.Element], bool]) -> ElementTree.Element:
        deadline = time.monotonic() + LIMIT_S
        while time.monotonic() < deadline:
            element = self.read()
            if accepts(element):
                return element
        raise TimeoutError

    def command(self, name: str, **attributes: object) -> int:
        given = "".join(f' {key}="{value}"' for key, value in attributes.items())
        self.socket.sendall(f'<Cmd Id="7" Name="{name}"{given}></Cmd>'.encode())
        answer = self.until(lambda element: element.tag == "Ack")
        assert (answer.get("Id"), answer.get("Cmd")) == ("7", name)
        return int(answer.get("Code", "-1"))

    def state(self, **wanted: str) -> ElementTree.Element:
        """The next unasked or asked state with these attributes."""
        self.socket.sendall(b'<Cmd Id="8" Name="STATUS"></Cmd>')
        return self.until(
            lambda e: e.tag == "State" and all(e.get(key) == value for key, value in wanted.items())
        )

    def raw(self, count: int) -> list[bytes]:
        """The next reads as they come."""
        return [self.socket.recv(65536) for _ in range(count)]

    def close(self) -> None:
        self.socket.close()


class Cell:
    """A running controller and its clients."""

    def __init__(self, stack: ExitStack, *options: str, world: World | None = None) -> None:
        self.rsi = RsiClient()
        stack.callback(self.rsi.socket.close)
        shared = ("--world", world.endpoint) if world is not None else ("--scene", "mini")
        arguments = ("--rsi", self.rsi.endpoint, "--eki", FREE, "--eki-project", FREE, *shared, *options)
        self.child = stack.enter_context(
            ChildProcess("ronna-sim kuka", command("sim.cli", "kuka", *arguments))
        )
        self._stack = stack

    def project(self) -> EkiClient:
        client = EkiClient(self.child.ready["endpoints"]["eki_project"], "Ack|State")
        self._stack.callback(client.close)
        return client

    def sdk(self) -> EkiClient:
        client = EkiClient(self.child.ready["endpoints"]["eki"], "Robot")
        self._stack.callback(client.close)
        return client

    def start(self, eki: EkiClient, **options: object) -> None:
        assert eki.command("DRIVES", On=1) == 0
        assert eki.command("RSI_START", Cycle=4, Ref="ABS", Corr="AXIS", **options) == 0
