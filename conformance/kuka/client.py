"""Minimal EKI and RSI client for a KUKA controller, independent of every driver.

It decodes elements independently, following the protocol reference, so that a driver's misreading cannot
hide. Its RSI replies hold the arm unless a case gives corrections.
"""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from xml.etree import ElementTree

from conformance.case import NotShown, check, read_as, require_present
from conformance.device_under_test import DeviceUnderTest
from ronna_hw.bounded_input import parse_xml
from ronna_hw.endpoints import Endpoint, parse_endpoint
from ronna_hw.wire.kuka_context import RsiContext, context_hash, load_context

ANSWER_LIMIT_S = 4.0  # as long as the vendor's client waits
MOST_BYTES = 65536
LONGEST_TELEGRAM = 16384  # the default BUFFSIZE of an EKI channel
_ELEMENT = re.compile(rb"<([A-Za-z]\w*)\b[^>]*>.*?</\1>", re.DOTALL)


class EkiLine:
    """Client of one EKI channel; `between` collects bytes received outside elements."""

    def __init__(self, endpoint: Endpoint) -> None:
        self.endpoint = endpoint
        self._socket = self._connect()
        self._received = b""
        self._number = 0
        self.between = b""

    def __enter__(self) -> EkiLine:
        return self

    def __exit__(self, *_reason: object) -> None:
        self.close()

    def close(self) -> None:
        self._socket.close()

    def reconnect(self) -> None:
        self._socket.close()
        self._received = b""
        self._socket = self._connect()

    def send(self, data: bytes) -> None:
        self._socket.sendall(data)

    def command(self, name: str, **attributes: object) -> str:
        """Send a command and return the identifier that its answers carry."""
        self._number += 1
        identifier = str(self._number)
        self.send(command(identifier, name, **attributes))
        return identifier

    @read_as("an answer with an integer Code")
    def ask(self, name: str, **attributes: object) -> int:
        """Send a command and return the code of its acknowledgement."""
        return int(self.answer("Ack", self.command(name, **attributes)).get("Code", "-1"))

    def state(self) -> ElementTree.Element:
        return self.answer("State", self.command("STATUS"))

    def answer(self, tag: str, identifier: str) -> ElementTree.Element:
        """Wait for the element with this tag and identifier; raises Nonconformity at the time limit."""
        until_s = time.monotonic() + ANSWER_LIMIT_S
        while True:
            while (raw := self._next_element()) is None:
                remaining_s = until_s - time.monotonic()
                wanted = f"{tag} {identifier} within {ANSWER_LIMIT_S:g} s"
                room = LONGEST_TELEGRAM - len(self._received)
                check(remaining_s > 0 and room > 0, wanted, self._received[-80:] or "nothing")
                self._socket.settimeout(remaining_s)
                try:
                    data = self._socket.recv(room)
                except TimeoutError:
                    continue
                check(bool(data), wanted, "the connection closed by the controller")
                self._received += data
            root = parse_xml(raw, LONGEST_TELEGRAM)
            if root.tag == tag and root.get("Id") == identifier:
                return root

    def is_closed_by_controller(self) -> bool:
        """Return whether the controller closes the connection in time."""
        until_s = time.monotonic() + ANSWER_LIMIT_S
        while (remaining_s := until_s - time.monotonic()) > 0:
            self._socket.settimeout(remaining_s)
            try:
                if not self._socket.recv(MOST_BYTES):
                    return True
            except TimeoutError:
                break
            except OSError:
                return True
        return False

    def _next_element(self) -> bytes | None:
        match = _ELEMENT.search(self._received)
        if match is None:
            return None
        self.between += self._received[: match.start()]
        self._received = self._received[match.end() :]
        return match[0]

    def _connect(self) -> socket.socket:
        try:
            eki_socket = socket.create_connection((self.endpoint.host, self.endpoint.port), ANSWER_LIMIT_S)
        except OSError as error:
            raise NotShown(f"no connection to {self.endpoint}: {error.strerror or error}") from error
        eki_socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return eki_socket


def command(identifier: str, name: str, **attributes: object) -> bytes:
    """Encode a command of our channel with a separate end tag."""
    text = "".join(f' {key}="{value}"' for key, value in attributes.items())
    return f'<Cmd Id="{identifier}" Name="{name}"{text}></Cmd>'.encode()


FIRST_LIMIT_S = 4.0  # from RSI_START to the first telegram; a real controller first computes its approach
NEXT_LIMIT_S = 1.0  # between two telegrams; a busy computer may stall
SILENT_S = 0.3  # a stream without telegrams for this long has ended
END_LIMIT_S = 4.0
AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
HOLD: Mapping[str, float] = dict.fromkeys(AXES, 0.0)

IPOC = re.compile(rb"<IPOC>(\d+)</IPOC>")
_DELAY = re.compile(rb'<Delay D="([^"]*)"')


@dataclass(frozen=True)
class Telegram:
    """Controller telegram, undecoded."""

    raw: bytes
    sender: tuple[str, int]
    received_s: float  # host time

    @property
    @read_as("an IPOC in digits")
    def ipoc(self) -> int:
        """Time stamp that the reply must echo."""
        return int(require_present(IPOC.search(self.raw), "an IPOC in digits", self.raw[-80:])[1])

    @property
    @read_as("an integer D")
    def late(self) -> int:
        match = _DELAY.search(self.raw)
        if match is None:
            raise NotShown("the controller sends no Delay")
        check(match[1].isdigit(), "an integer D", match[1])
        return int(match[1])

    @read_as("an element with numbers")
    def values(self, tag: str) -> dict[str, float]:
        found = parse_xml(self.raw, MOST_BYTES).find(tag)
        if found is None:
            raise NotShown(f"the controller sends no {tag}")
        return {name: float(value) for name, value in found.attrib.items()}


@dataclass
class RsiLine:
    """Client side of a running RSI stream, with the EKI connection that started it."""

    socket: socket.socket
    eki: EkiLine
    context: RsiContext

    def next(self) -> Telegram:
        """Receive the next telegram; raises Nonconformity if none arrives."""
        telegram = self._receive(NEXT_LIMIT_S)
        return require_present(telegram, f"a telegram within {NEXT_LIMIT_S:g} s", "nothing")

    def answer(
        self, telegram: Telegram, corrections: Mapping[str, float] = HOLD, *, stop: bool = False
    ) -> None:
        self.send(telegram, self.reply(telegram.ipoc, corrections, stop=stop))

    def send(self, telegram: Telegram, reply: bytes) -> None:
        self.socket.sendto(reply, telegram.sender)

    def reply(
        self,
        ipoc: int,
        corrections: Mapping[str, float] = HOLD,
        *,
        stop: bool = False,
        sentype: str | None = None,
    ) -> bytes:
        """Build a reply with the elements wired in the RSI context; corrections in deg."""
        body = ""
        if (tag := self.context.find_wired_tag("STOP", "In1")) is not None:
            body += f"<{tag}>{int(stop)}</{tag}>"
        tags = [self.context.find_wired_tag("AXISCORR", axis) for axis in AXES]
        if all(tags):
            name = str(tags[0]).partition(".")[0]
            attributes = " ".join(
                f'{str(tag).partition(".")[2]}="{corrections[axis]:.4f}"'
                for tag, axis in zip(tags, AXES, strict=True)
            )
            body += f"<{name} {attributes}/>"
        sentype = sentype or self.context.ethernet.sentype
        return f'<Sen Type="{sentype}">{body}<IPOC>{ipoc}</IPOC></Sen>'.encode()

    def run_cycles(self, count: int, corrections: Mapping[str, float] = HOLD) -> list[Telegram]:
        """Answer the next `count` telegrams and return them."""
        telegrams = []
        for _ in range(count):
            telegrams.append(self.next())
            self.answer(telegrams[-1], corrections)
        return telegrams

    def await_silence(self, *, with_replies: bool = True) -> list[Telegram]:
        """Wait for the stream to end and return the remaining telegrams."""
        telegrams: list[Telegram] = []
        until_s = time.monotonic() + END_LIMIT_S
        while (telegram := self._receive(SILENT_S)) is not None:
            check(time.monotonic() < until_s, f"a stream that ends within {END_LIMIT_S:g} s")
            telegrams.append(telegram)
            if with_replies:
                self.answer(telegram)
        return telegrams

    def _receive(self, limit_s: float) -> Telegram | None:
        self.socket.settimeout(limit_s)
        try:
            raw, sender = self.socket.recvfrom(MOST_BYTES)
        except TimeoutError:
            return None
        return Telegram(raw, sender, time.monotonic())


@contextmanager
def eki_line(dut: DeviceUnderTest) -> Iterator[EkiLine]:
    """Yield a plain EKI client, closing every driver connection first."""
    endpoint = _endpoint(dut, "eki_project")
    dut.release()
    with EkiLine(parse_endpoint(endpoint).require("tcp")) as line:
        yield line


@contextmanager
def idle_controller(dut: DeviceUnderTest) -> Iterator[tuple[EkiLine, socket.socket]]:
    """Yield the EKI client of a controller ready to start RSI, and the socket for the stream."""
    where = parse_endpoint(_endpoint(dut, "rsi")).require("udp")
    with eki_line(dut) as eki, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as ours:
        ours.bind((where.host, where.port))
        state = eki.state()
        if state.get("CtxHash") != context_hash(load_context()):
            raise NotShown("the controller runs another RSI context than ours")
        if state.get("Mode") != "EXT":
            raise NotShown(f"the controller is in mode {state.get('Mode')}, not EXT")
        if state.get("Err") != "0":
            eki.ask("ACK_ERRORS")
        if state.get("Drives") != "1":
            check(eki.ask("DRIVES", On=1) == 0, "drives that can be switched on")
        yield eki, ours
        if eki.state().get("Err") != "0":
            eki.ask("ACK_ERRORS")


@contextmanager
def stream(dut: DeviceUnderTest) -> Iterator[RsiLine]:
    """Start an RSI stream and stop it after the block."""
    with idle_controller(dut) as (eki, ours):
        check(eki.ask("RSI_START") == 0, "a program that starts")
        line = RsiLine(ours, eki, load_context())
        try:
            yield line
        finally:
            eki.command("RSI_STOP")
            line.await_silence()


def _endpoint(dut: DeviceUnderTest, name: str) -> str:
    if name not in dut.config.endpoints:
        raise NotShown(f"no endpoint {name} given")
    return dut.config.endpoints[name]
