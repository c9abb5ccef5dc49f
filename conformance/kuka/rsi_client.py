"""A plain RSI client of a KUKA controller that bypasses every driver.

Its replies hold the arm unless a case gives corrections.
"""

from __future__ import annotations

import re
import socket
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass

from conformance.case import NotShown, check, read_as
from conformance.device_under_test import DeviceUnderTest
from conformance.kuka.eki_client import EkiLine
from ronna_hw.bounded_input import parse_xml
from ronna_hw.endpoints import parse_endpoint
from ronna_hw.wire.kuka_context import RsiContext, context_hash, load_context

FIRST_LIMIT_S = 4.0  # from RSI_START to the first telegram; a real controller first computes its approach
NEXT_LIMIT_S = 1.0  # between two telegrams; a busy computer may stall
SILENT_S = 0.3  # a stream without telegrams for this long has ended
END_LIMIT_S = 4.0
MOST_BYTES = 65536
AXES = ("A1", "A2", "A3", "A4", "A5", "A6")
HOLD: Mapping[str, float] = dict.fromkeys(AXES, 0.0)

_IPOC = re.compile(rb"<IPOC>(\d+)</IPOC>")
_DELAY = re.compile(rb'<Delay D="([^"]*)"')


@dataclass(frozen=True)
class Telegram:
    """One telegram of the controller as received."""

    raw: bytes
    sender: tuple[str, int]
    at_s: float  # host time

    @property
    @read_as("an IPOC in digits")
    def ipoc(self) -> int:
        """The time stamp that a reply must carry."""
        match = _IPOC.search(self.raw)
        check(match is not None, "an IPOC in digits", self.raw[-80:])
        assert match is not None
        return int(match[1])

    @property
    @read_as("an integer D")
    def late(self) -> int:
        """The delay counter D."""
        match = _DELAY.search(self.raw)
        if match is None:
            raise NotShown("the controller sends no Delay")
        check(match[1].isdigit(), "an integer D", match[1])
        return int(match[1])

    @read_as("an element with numbers")
    def values(self, tag: str) -> dict[str, float]:
        """Attributes of an element as numbers."""
        found = parse_xml(self.raw, MOST_BYTES).find(tag)
        if found is None:
            raise NotShown(f"the controller sends no {tag}")
        return {name: float(value) for name, value in found.attrib.items()}


@dataclass
class RsiLine:
    """Our end of a running stream, and the EKI connection that started it."""

    socket: socket.socket
    eki: EkiLine
    context: RsiContext

    def next(self, limit_s: float = NEXT_LIMIT_S) -> Telegram:
        """The next telegram; raises Nonconformity if none arrives."""
        telegram = self._receive(limit_s)
        check(telegram is not None, f"a telegram within {limit_s:g} s", "nothing")
        assert telegram is not None
        return telegram

    def next_if_any(self, limit_s: float = SILENT_S) -> Telegram | None:
        """The next telegram, or None if the stream has ended."""
        return self._receive(limit_s)

    def answer(
        self, telegram: Telegram, corrections: Mapping[str, float] = HOLD, *, stop: bool = False
    ) -> None:
        """The correct reply to a telegram."""
        self.send(telegram, self.reply(telegram.ipoc, corrections, stop=stop))

    def send(self, telegram: Telegram, reply: bytes) -> None:
        """Send bytes to the sender of a telegram."""
        self.socket.sendto(reply, telegram.sender)

    def reply(
        self,
        ipoc: int,
        corrections: Mapping[str, float] = HOLD,
        *,
        stop: bool = False,
        sentype: str | None = None,
    ) -> bytes:
        """A reply with the elements wired in the controller's context; corrections in deg."""
        body = ""
        if (tag := self.context.wired_tag("STOP", "In1")) is not None:
            body += f"<{tag}>{int(stop)}</{tag}>"
        tags = [self.context.wired_tag("AXISCORR", axis) for axis in AXES]
        if all(tags):
            name = str(tags[0]).partition(".")[0]
            attributes = " ".join(
                f'{str(tag).partition(".")[2]}="{corrections[axis]:.4f}"'
                for tag, axis in zip(tags, AXES, strict=True)
            )
            body += f"<{name} {attributes}/>"
        sentype = sentype or self.context.ethernet.sentype
        return f'<Sen Type="{sentype}">{body}<IPOC>{ipoc}</IPOC></Sen>'.encode()

    def cycles(self, count: int, corrections: Mapping[str, float] = HOLD) -> list[Telegram]:
        """Answer this many telegrams; returns them."""
        telegrams = []
        for _ in range(count):
            telegrams.append(self.next())
            self.answer(telegrams[-1], corrections)
        return telegrams

    def until_silent(self, limit_s: float = END_LIMIT_S, *, answered: bool = True) -> list[Telegram]:
        """Wait for the end of the stream; returns the telegrams that still arrived."""
        telegrams: list[Telegram] = []
        until_s = time.monotonic() + limit_s
        while (telegram := self.next_if_any()) is not None:
            check(time.monotonic() < until_s, f"a stream that ends within {limit_s:g} s")
            telegrams.append(telegram)
            if answered:
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
    """A plain client of the EKI channel; closes every connection of the driver first."""
    endpoint = _endpoint(dut, "eki_project")
    dut.release()
    with EkiLine(parse_endpoint(endpoint).require("tcp")) as line:
        yield line


@contextmanager
def idle_controller(dut: DeviceUnderTest) -> Iterator[tuple[EkiLine, socket.socket]]:
    """A controller ready to start its program, and the socket it will stream to."""
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
def stream(dut: DeviceUnderTest, prepare: Callable[[socket.socket], None] | None = None) -> Iterator[RsiLine]:
    """A freshly started stream, ended after the block."""
    with idle_controller(dut) as (eki, ours):
        if prepare is not None:
            prepare(ours)
        check(eki.ask("RSI_START") == 0, "a program that starts")
        line = RsiLine(ours, eki, load_context())
        try:
            yield line
        finally:
            eki.command("RSI_STOP")
            line.until_silent()


def _endpoint(dut: DeviceUnderTest, name: str) -> str:
    if name not in dut.config.endpoints:
        raise NotShown(f"no endpoint {name} given")
    return dut.config.endpoints[name]
