"""Minimal client for an NDI Polaris unit, independent of every driver.

It decodes replies, also BX (options 0001, 0002, 0800, 1000), independently, following the protocol reference,
so that a driver's misreading cannot hide.
"""

from __future__ import annotations

import math
import re
import select
import socket
import struct
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass

from conformance.case import Nonconformity, check, read_as, require_present
from conformance.device_under_test import DeviceUnderTest
from ronna_hw.wire.polaris import (
    BX_CRC_BYTES,
    BX_HEADER_BYTES,
    BX_START,
    COMM_DEFAULT_ARGUMENT,
    DEFAULT_BAUD,
    PHRQ_ANY_PASSIVE,
    PVWR_BLOCK_BYTES,
    REPLY_OKAY,
    HandleStatus,
    PortStatus,
    crc16,
)

REPLY_LIMIT_S = 6.0  # the unit's longest time limit for the commands used here
BREAK_S = 0.5
FAST_BAUD, FAST_ARGUMENT = 115200, "50000"  # supported by every unit and every adapter
RATE_SETTLING_S = 0.1  # from OKAY until the unit uses the new rate
RESET_LIMIT_S = 7.0  # from a break to the unit's RESET: as long as any client waits
LONGEST_HEARD_BYTES = 1 << 20  # of a reply, or of a line that should fall silent: ten times any
SHOWN_BYTES = 80  # of what is no reply
QUIET_S = 0.02  # an idle line counts as quiet after this
_ASCII = re.compile(rb"(.*)([0-9A-F]{4})\r", re.DOTALL)
_ERROR = re.compile("ERROR[0-9A-F]{2}")


class SerialLine:
    """Serial port at the unit's power-up baud rate, with the socket methods used here."""

    def __init__(self, path: str) -> None:
        import serial

        self._port = serial.Serial(path, DEFAULT_BAUD, timeout=0, write_timeout=REPLY_LIMIT_S, exclusive=True)

    def fileno(self) -> int:
        return int(self._port.fileno())

    def sendall(self, data: bytes) -> None:
        self._port.write(data)

    def recv(self, size: int) -> bytes:
        return bytes(self._port.read(size))

    @property
    def baud(self) -> int:
        return int(self._port.baudrate)

    @baud.setter
    def baud(self, rate: int) -> None:
        self._port.baudrate = rate

    def send_break(self) -> None:
        """Discard buffered data and send a break, which resets the unit."""
        import termios

        termios.tcflush(self.fileno(), termios.TCIOFLUSH)
        self._port.send_break(BREAK_S)

    def close(self) -> None:
        self._port.close()


def with_crc(text: str) -> bytes:
    """Encode a command or text reply with its CRC, in four upper-case hex digits, and CR."""
    return b"%b%04X\r" % (text.encode(), crc16(text.encode()))


@dataclass
class PolarisLink:
    """Connection to a unit that checks the CRC of every reply."""

    line: socket.socket | SerialLine
    definition: bytes = b""  # of the driver's first tool, for cases that need one

    def ask(self, command: str | bytes) -> str:
        """Send a command and return the reply's text; text commands get a CRC, bytes are sent unchanged."""
        self.send(command)
        return self.text()

    def send(self, command: str | bytes) -> None:
        self.line.sendall(with_crc(command) if isinstance(command, str) else command)

    @read_as("a reply in ASCII")
    def text(self, limit_s: float = REPLY_LIMIT_S) -> str:
        """Receive the text of the next ASCII reply and check its CRC."""
        heard = self._read_until(lambda data: data.endswith(b"\r"), limit_s)
        match = require_present(_ASCII.fullmatch(heard), "text, four upper-case hex digits and CR", heard)
        check(int(match[2], 16) == crc16(match[1]), f"the CRC {crc16(match[1]):04X}", match[2].decode())
        return match[1].decode("ascii")

    def ask_binary(self, command: str) -> bytes:
        """Send a command and return the body of its binary reply, after checking framing and CRCs."""
        self.send(command)
        heard = self._read_until(lambda data: len(data) >= BX_HEADER_BYTES)
        start, length, crc = struct.unpack_from("<HHH", heard)
        check(start == BX_START, "the start sequence C4 A5", heard[:8].hex(" "))
        check(crc == crc16(heard[:4]), f"the header CRC {crc16(heard[:4]):04X}", f"{crc:04X}")
        whole = BX_HEADER_BYTES + length + BX_CRC_BYTES
        heard += self._read_until(lambda data: len(heard) + len(data) >= whole) if len(heard) < whole else b""
        check(len(heard) == whole, f"a reply of {whole} bytes", len(heard))
        body = heard[BX_HEADER_BYTES : whole - BX_CRC_BYTES]
        (crc,) = struct.unpack_from("<H", heard, whole - BX_CRC_BYTES)
        check(crc == crc16(body), f"the body CRC {crc16(body):04X}", f"{crc:04X}")
        return body

    def read_rest(self, quiet_s: float = QUIET_S) -> bytes:
        """Receive everything until the line has been quiet for `quiet_s`."""
        heard = b""
        while select.select([self.line], [], [], quiet_s)[0]:
            if not (data := self.line.recv(65536)):
                break
            heard += data
            check(len(heard) <= LONGEST_HEARD_BYTES, "a line that falls silent", f"{len(heard)} bytes")
        return heard

    def expect_okay(self, command: str | bytes) -> None:
        reply = self.ask(command)
        check(reply == REPLY_OKAY, f"OKAY to {command!r}", reply)

    def refused(self, command: str | bytes, *codes: int) -> None:
        wanted = [f"ERROR{code:02X}" for code in codes]
        reply = self.ask(command)
        check(reply in wanted, f"{' or '.join(wanted)} to {command!r}", reply)

    def load_tool(self, definition: bytes) -> str:
        """Load, initialise and enable a tool; returns its port handle as two hex digits."""
        handle = self.request_handle()
        self.write(handle, definition)
        reply = self.ask(f"PINIT:{handle}")
        check(reply == REPLY_OKAY or reply.startswith("WARNING"), "OKAY or WARNING to PINIT", reply)
        self.expect_okay(f"PENA:{handle}D")
        return handle

    def write(self, handle: str, definition: bytes) -> None:
        for address in range(0, len(definition), PVWR_BLOCK_BYTES):
            block = definition[address : address + PVWR_BLOCK_BYTES].ljust(PVWR_BLOCK_BYTES, b"\0")
            self.expect_okay(f"PVWR:{handle}{address:04X}{block.hex().upper()}")

    def request_handle(self) -> str:
        handle = self.ask(f"PHRQ:{PHRQ_ANY_PASSIVE}")
        check(re.fullmatch("[0-9A-F]{2}", handle) is not None and handle != "00", "a handle", handle)
        return handle

    @read_as("a count and five digits per handle")
    def handles(self, query: str = "00") -> list[str]:
        """List the port handles for a PHSR query, as two hex digits each."""
        text = self.ask(f"PHSR:{query}")
        check(len(text) == 2 + 5 * int(text[:2], 16), "a count and five digits per handle", text)
        return [text[at : at + 2] for at in range(2, len(text), 5)]

    def clean_up(self) -> None:
        self.read_rest()
        self.ask("TSTOP:")  # refused if not tracking
        for handle in self.handles():
            self.ask(f"PHF:{handle}")

    def switch_baud(self, argument: str, baud: int) -> None:
        """Switch both ends of the line to another baud rate with COMM."""
        self.expect_okay(f"COMM:{argument}")  # answered at the old rate
        time.sleep(RATE_SETTLING_S)
        self.serial.baud = baud
        self.read_rest()

    @contextmanager
    def fast_baud(self) -> Iterator[None]:
        """Use a faster baud rate for the block if the line is serial; no effect over TCP."""
        if not isinstance(self.line, SerialLine):
            yield
            return
        self.switch_baud(FAST_ARGUMENT, FAST_BAUD)
        try:
            yield
        finally:
            self.read_rest()
            self.ask("TSTOP:")  # refused if not tracking
            self.switch_baud(COMM_DEFAULT_ARGUMENT, DEFAULT_BAUD)

    @property
    def serial(self) -> SerialLine:
        """Serial port, for cases that need SERIAL_LINE."""
        assert isinstance(self.line, SerialLine), "the case needs a serial line"
        return self.line

    def _read_until(self, complete: Callable[[bytes], bool], limit_s: float = REPLY_LIMIT_S) -> bytes:
        heard = b""
        until_s = time.monotonic() + limit_s
        while not complete(heard):
            remaining_s = until_s - time.monotonic()
            ready = remaining_s > 0 and select.select([self.line], [], [], remaining_s)[0]
            data = self.line.recv(65536) if ready else b""
            whole = bool(data) and len(heard) < LONGEST_HEARD_BYTES
            check(whole, f"a reply within {limit_s:g} s", heard[-SHOWN_BYTES:].hex(" ") or "nothing")
            heard += data
        return heard


def is_error(text: str) -> bool:
    return _ERROR.fullmatch(text) is not None


@contextmanager
def plain_unit(dut: DeviceUnderTest) -> Iterator[PolarisLink]:
    """Yield a plain client of the unit under test, without initialising the unit."""
    dut.release()
    endpoint = dut.endpoint
    with closing(
        SerialLine(endpoint.path)
        if endpoint.scheme == "serial"
        else socket.create_connection((endpoint.host, endpoint.port), REPLY_LIMIT_S)
    ) as line:
        link = PolarisLink(line)
        link.read_rest()
        yield link


@contextmanager
def idle_unit(dut: DeviceUnderTest) -> Iterator[PolarisLink]:
    """Yield a plain client of an initialised unit with no tools loaded."""
    with plain_unit(dut) as link:
        link.expect_okay("INIT:")
        link.clean_up()
        yield link
        link.clean_up()


Vector3 = tuple[float, float, float]

TOOL_INFORMATION_BYTES = 11
POSITION_BYTES = 12
OPTION_TOOL_INFORMATION = 0x0002
OPTION_OUT_OF_VOLUME = 0x0800
OPTION_STRAYS = 0x1000


@dataclass(frozen=True)
class HandleReport:
    """State of one handle; `pose` is q0 qx qy qz tx ty tz error, None for a missing tool."""

    handle: str
    status: HandleStatus
    pose: tuple[float, ...] | None = None
    port_status: int = 0
    frame: int = 0

    @property
    def outside(self) -> bool:
        return bool(self.port_status & PortStatus.OUT_OF_VOLUME)


@dataclass(frozen=True)
class BxReply:
    """Decoded BX reply; `strays_at` is the offset of the first stray's position in the body.

    `strays_outside` are the flags with the low bit of each byte first, as most clients read them,
    `strays_outside_mirrored` with the high bit first: the order is undocumented.
    """

    handles: tuple[HandleReport, ...]
    strays_mm: tuple[Vector3, ...]
    strays_outside: tuple[bool, ...]
    strays_outside_mirrored: tuple[bool, ...]
    strays_at: int
    system_status: int

    @property
    def frame(self) -> int:
        """Latest frame number of any handle."""
        return max((handle.frame for handle in self.handles), default=0)


def read_body(body: bytes, options: int) -> BxReply:
    """Decode the body of a BX reply with option 0001; raises Nonconformity if its length is wrong."""
    try:
        return _read_body(body, options)
    except (struct.error, IndexError) as error:
        raise Nonconformity(f"expected a whole body, got {len(body)} bytes: {error}") from error


def _read_body(body: bytes, options: int) -> BxReply:
    at, handles = 1, []
    for _ in range(body[0]):
        handle, status = f"{body[at]:02X}", body[at + 1]
        at += 2
        if status == HandleStatus.DISABLED:
            handles.append(HandleReport(handle, HandleStatus.DISABLED))
            continue
        check(status in (HandleStatus.VALID, HandleStatus.MISSING), "handle status 01, 02 or 04", status)
        pose = None
        if status == HandleStatus.VALID:
            pose = struct.unpack_from("<8f", body, at)
            at += 32
        port_status, frame = struct.unpack_from("<2I", body, at)
        at += 8 + (TOOL_INFORMATION_BYTES if options & OPTION_TOOL_INFORMATION else 0)
        handles.append(HandleReport(handle, HandleStatus(status), pose, port_status, frame))
    strays: list[Vector3] = []
    outside: tuple[bool, ...] = ()
    mirrored: tuple[bool, ...] = ()
    strays_at = at
    if options & OPTION_STRAYS:
        count = body[at]
        bits = body[at + 1 : at + 1 + (count + 7) // 8]
        outside = tuple(bool(bits[index // 8] & 1 << index % 8) for index in range(count))
        mirrored = tuple(bool(bits[index // 8] & 0x80 >> index % 8) for index in range(count))
        strays_at = at = at + 1 + len(bits)
        positions = count if options & OPTION_OUT_OF_VOLUME else outside.count(False)
        for _ in range(positions):
            x, y, z = struct.unpack_from("<3f", body, at)
            strays.append((x, y, z))
            at += POSITION_BYTES
    check(len(body) == at + 2, f"{at + 2} bytes in the body", len(body))
    (system_status,) = struct.unpack_from("<H", body, at)
    return BxReply(tuple(handles), tuple(strays), outside, mirrored, strays_at, system_status)


def place_markers(markers_mm: tuple[Vector3, ...], pose: tuple[float, ...]) -> list[Vector3]:
    """Transform a tool's markers to the tracker frame; the pose has a scalar-first quaternion."""
    q0, qx, qy, qz, tx, ty, tz, _ = pose
    norm = math.sqrt(q0 * q0 + qx * qx + qy * qy + qz * qz)
    q0, qx, qy, qz = q0 / norm, qx / norm, qy / norm, qz / norm
    rows = (
        (1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - q0 * qz), 2 * (qx * qz + q0 * qy), tx),
        (2 * (qx * qy + q0 * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - q0 * qx), ty),
        (2 * (qx * qz - q0 * qy), 2 * (qy * qz + q0 * qx), 1 - 2 * (qx * qx + qy * qy), tz),
    )
    moved = [tuple(a * x + b * y + c * z + t for a, b, c, t in rows) for x, y, z in markers_mm]
    return [(x, y, z) for x, y, z in moved]
