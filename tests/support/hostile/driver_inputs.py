"""What devices send to the drivers, and the simulated controller's replies, with what takes them."""

from __future__ import annotations

import contextlib
import re
import socket
import struct
import zipfile
from collections.abc import Callable, Iterator
from math import isfinite
from typing import cast
from unittest import mock

from good_inputs import DESCRIPTION, FORMULAS, PACKET_BYTES, REPLIES, STATE, TELEGRAM, Take, packets, zipped
from handmade_ur import INPUT_TYPES, OUTPUT_TYPES, robot_state, rtde
from rtde_stand import IN
from rtde_stand import streaming as rtde_streaming

from drivers.basler_stereo import gvcp
from drivers.basler_stereo.features.description import parse_description, parse_url, unzip_description
from drivers.basler_stereo.features.feature_map import FeatureMap
from drivers.basler_stereo.features.formula import evaluate
from drivers.basler_stereo.identity import decode_identity
from drivers.basler_stereo.stream.frame_assembler import FrameAssembler
from drivers.kuka_rsi.eki.telegrams import TelegramScanner, parse_telegram, read_state
from drivers.kuka_rsi.realtime.telegram import TelegramReader
from drivers.ndi_polaris.command_link import decode_ascii, split_binary
from drivers.ndi_polaris.measuring_volume import parse_volumes
from drivers.ndi_polaris.replies import FRAME_OPTIONS, decode_bx, decode_tx
from drivers.ndi_polaris.shipped_tools import FOLDER as SHIPPED_TOOLS
from drivers.ndi_polaris.tool_definition import decode_definition
from drivers.universal_robots.dashboard import DashboardClient
from drivers.universal_robots.primary.client import package_size
from drivers.universal_robots.primary.packages import iterate_parts, read_message
from drivers.universal_robots.realtime.line import RtdeLine, is_output
from drivers.universal_robots.realtime.packages import OUTPUT
from drivers.universal_robots.rtde import RtdeSetup
from ronna_hw.arm_stream.control_channel import RECEIVE_BYTES
from ronna_hw.arm_stream.records import Orders
from ronna_hw.bounded_input import InputRefused
from ronna_hw.errors import RonnaError
from ronna_hw.wire import polaris
from ronna_hw.wire.kuka_context import load_context
from ronna_hw.wire.polaris import ReplyOption
from ronna_hw.wire.universal_robots_services import DashboardOrder, PackageKind, Query
from sim.kuka.rsi.telegrams import ReplyReader

OUTPUT_PACKAGE = rtde_streaming().package()
PRIMARY_STATE = robot_state()
SETUP_REPLIES = b"".join(
    (
        rtde("V", b"\1"),
        rtde("v", struct.pack(">4I", 5, 11, 5, 1010327)),
        rtde("M", b"\2hi\1m\3"),
        rtde("O", b"\1" + OUTPUT_TYPES.encode()),
        rtde("I", b"\1" + INPUT_TYPES.encode()),
    )
)
DASHBOARD_LINES = (
    b"Connected: Universal Robots Dashboard Server\nRobotmode: RUNNING\nSafetymode: NORMAL\ntrue\n"
    b"Program running: false\n20265500001\nPowering on\n"
)
PRIMARY_MESSAGE = struct.pack(">iBQbB", 30, 20, 0, -2, 7) + b"PolyScope hello."
MARKERS = b"\0" + bytes.fromhex("33330000000000000000")[::-1]  # of a tool in a BX reply: all four are used
MARKER_DIGITS = b"0033330000000000000000"  # and in a TX reply
_IN_PIECES = re.compile(rb"&|<[!?]")  # XML in which a text need not be together


def driver_parsers() -> dict[str, tuple[tuple[bytes, ...], Take]]:
    """What each takes when all is well, and what takes it."""
    ours = load_context()
    sentype = ours.ethernet.sentype.encode()
    bx = (
        struct.pack("<3B8f2I", 1, 2, 1, 1.0, 0, 0, 0, 10.0, -20.0, -1500.0, 0.1, 0x31, 300)
        + MARKERS
        + struct.pack("<BH", 0, 0),
        struct.pack("<3B2I", 2, 1, 2, 0x31, 301)
        + MARKERS
        + struct.pack("<2BBB3fH", 2, 4, 1, 0, 10.0, -20.0, -1500.0, 0),
    )
    tx = (
        b"0102+10000+00000+00000+00000+001050-002025-150000+00125000000310000012C%b\n000000" % MARKER_DIGITS,
        b"0101MISSING000000310000012D%b\n033+001000+002000-150000-001000-002000-250000"
        b"+000000+000000-1000000002" % MARKER_DIGITS,
    )
    return {
        "GenICam XML": ((DESCRIPTION,), _features),
        "GenICam ZIP": ((zipped(DESCRIPTION), zipped(DESCRIPTION, zipfile.ZIP_STORED)), unzip_description),
        "GenICam formula": (FORMULAS, _formula),
        "GVCP": (
            tuple(
                struct.pack(">4H", 0, command, len(payload), 1) + payload
                for command, payload in (
                    (0x81, b"\0\0\0\7"),
                    (0x85, struct.pack(">I8x", 0x200)),
                    (3, bytes(248)),
                    (0x89, b"\0\0\0\7"),
                    (0x81, b"Local:cam.xml;100000;4ed4"),
                )
            ),
            _gvcp,
        ),
        "GVSP": ((packets(),), _gvsp),
        "Polaris BX": (bx, _binary),
        "Polaris text": (
            (
                *tx,
                b"15-000240000-000095000-000055700+000015200+000031100+000035600+000041400+000049500+000078300+000093500",
            ),
            _with_right_crc,
        ),
        "Polaris .rom": (((SHIPPED_TOOLS / "robot_frame.rom").read_bytes(),), _rom),
        "EKI": ((STATE, STATE + b"\0\r\n" + STATE), _eki),
        "RSI": ((TELEGRAM,), _rsi(TelegramReader(("DEF_RIst", "DEF_AIPos", "DEF_EIPos", "DEF_Delay")))),
        "RTDE": ((OUTPUT_PACKAGE * 3,), _rtde),
        "RTDE set-up": ((SETUP_REPLIES,), _rtde_setup),
        "UR dashboard": ((DASHBOARD_LINES,), _dashboard),
        "UR primary": ((PRIMARY_STATE, PRIMARY_STATE + PRIMARY_MESSAGE), _primary),
        "RSI reply": (
            tuple(reply.replace(b"RONNA", sentype) for reply in REPLIES),
            _reply(ReplyReader(ours.receive, ours.ethernet.sentype), sentype),
        ),
    }


class _Given:
    """Socket that gives what it was given, then ends."""

    def __init__(self, data: bytes) -> None:
        self._data = memoryview(data)

    def setblocking(self, _blocking: bool) -> None: ...

    def setsockopt(self, *_option: object) -> None: ...

    def close(self) -> None: ...

    def recv_into(self, buffer: memoryview) -> int:
        part = self._data[: len(buffer)]
        buffer[: len(part)] = part
        self._data = self._data[len(part) :]
        return len(part)


def _rtde(data: bytes) -> None:
    """No package moves an arm that is holding."""
    line, given = RtdeLine(), cast(socket.socket, _Given(data))
    line.attach(given)
    stand = rtde_streaming()
    session = stand.session
    held = stand.goal
    try:
        while True:
            package = line.receive()
            if not is_output(package, 1):
                continue
            stand.now_ns += 2_000_000
            reply = session.answer(
                OUTPUT.unpack_from(package), Orders(stand.beat, 0, stand.commands), stand.now_ns
            )
            if reply is not None:
                assert IN.unpack(reply)[6:] == held
                session.finish_cycle(None)
            if session.fault:
                return
    except OSError:
        if line.broken != "the controller closed the connection":
            raise InputRefused(line.broken) from None


class _Replies:
    """Socket that gives a line, or a piece, of what it was given at a time, whatever is asked."""

    def __init__(self, pieces: list[bytes]) -> None:
        self._pieces = iter(pieces)
        self._rest = b""  # of a piece

    def setsockopt(self, *_option: object) -> None: ...

    def settimeout(self, _seconds: float) -> None: ...

    def sendall(self, _data: bytes) -> None: ...

    def shutdown(self, _how: int) -> None: ...

    def close(self) -> None: ...

    def recv(self, most: int, flags: int = 0) -> bytes:
        if flags:
            raise BlockingIOError  # nothing has arrived that was not asked for
        piece = self._rest or next(self._pieces, b"")
        self._rest = piece[most:]
        return piece[:most]


@contextlib.contextmanager
def _answered(pieces: list[bytes]) -> Iterator[None]:
    """Let whoever connects get these pieces."""
    with mock.patch("socket.create_connection", return_value=_Replies(pieces)):
        yield


def _rtde_setup(data: bytes) -> None:
    with _answered([data]):
        setup = RtdeSetup("127.0.0.1", 1, 1.0)
    assert all(number >= 0 for number in setup.read_version())
    assert 0 < setup.set_up_outputs(500.0) < 256
    assert 0 < setup.set_up_inputs() < 256


def _dashboard(data: bytes) -> None:
    with _answered(data.splitlines(keepends=True)):
        client = DashboardClient("127.0.0.1", 1, 1.0)
    client.robot_mode(1.0)
    client.safety_mode(1.0)
    client.is_remote(1.0)
    client.is_program_running(1.0)
    client.ask(Query.SERIAL_NUMBER, 1.0)
    client.require(DashboardOrder.POWER_ON, 1.0)


def _primary(data: bytes) -> None:
    while (size := package_size(data)) is not None and len(data) >= size:
        payload = data[5:size]
        if data[4] == PackageKind.MESSAGE:
            assert read_message(payload).text.isprintable()
        elif data[4] == PackageKind.ROBOT_STATE:
            list(iterate_parts(payload))
        data = data[size:]


class _Camera:
    def read(self, address: int, count: int) -> bytes:
        return struct.pack(">I", address % (1 << 32)) * (count // 4)

    def write(self, address: int, data: bytes) -> None:
        assert len(data) % 4 == 0
        assert 0 <= address < 1 << 32


def _features(data: bytes) -> None:
    nodes = parse_description(data)
    features = FeatureMap(nodes, _Camera())
    for name in list(nodes)[:50]:
        for ask in (
            features.number,
            features.limits,
            features.has,
            features.entries,
            features.choice,
            lambda name: features.set_number(name, 5),
            features.command_write,
        ):
            with contextlib.suppress(RonnaError):
                ask(name)


def _gvcp(data: bytes) -> None:
    acknowledge = gvcp.decode(data)
    if acknowledge is None:
        return
    assert len(acknowledge.payload) <= len(data) - 8
    gvcp.pending_ms(acknowledge.payload)
    for read in (
        lambda payload: decode_identity(payload, "127.0.0.1"),
        lambda payload: gvcp.register_value(payload, "a register"),
        lambda payload: gvcp.memory_data(payload, 0x200, 8),
        lambda payload: parse_url(payload.decode("ascii", "replace")),
    ):
        with contextlib.suppress(RonnaError):
            read(gvcp.require_success(acknowledge, "asking"))


def _gvsp(data: bytes) -> None:
    assembler = FrameAssembler(1200, 136)
    for number, begin in enumerate(range(0, len(data), PACKET_BYTES)):
        frame = assembler.accept(memoryview(data)[begin : begin + PACKET_BYTES], 0.01 * number)
        if frame is not None and frame.leader is not None:
            assert frame.leader.area
        assembler.find_overdue(0.01 * number)
    assembler.find_overdue(1000.0)


def _eki(data: bytes) -> None:
    scanner = TelegramScanner()
    for begin in range(0, len(data), RECEIVE_BYTES):
        for telegram in scanner.feed(data[begin : begin + RECEIVE_BYTES]):
            read_state(parse_telegram(telegram), 0.0)


def _with_right_crc(data: bytes) -> None:
    """The CRC is no secret: who means ill sends the right one."""
    text = data.replace(b"\r", b"")
    for options in (FRAME_OPTIONS, ReplyOption.TRANSFORMS):
        with contextlib.suppress(RonnaError):
            reply = decode_tx(decode_ascii(text + b"%04X" % polaris.crc16(text)), options)
            positions = [report.position_mm for report in reply.handles if report.position_mm is not None]
            assert all(isfinite(value) for position in positions for value in position)
    with contextlib.suppress(RonnaError):
        parse_volumes(decode_ascii(text + b"%04X" % polaris.crc16(text)))


def _binary(data: bytes) -> None:
    with contextlib.suppress(RonnaError):
        split_binary(data)
    with contextlib.suppress(RonnaError):
        assert len(decode_bx(data, ReplyOption.TRANSFORMS).handles) == data[0]
    assert len(decode_bx(data).handles) == data[0]


def _rom(data: bytes) -> None:
    block = bytearray(data.ljust(752, b"\0")[:752])
    struct.pack_into("<H", block, 4, sum(block[6:]) & 0xFFFF)  # a right checksum
    with contextlib.suppress(RonnaError):
        decode_definition(bytes(block))
    decode_definition(data)


def _formula(data: bytes) -> None:
    text = data.decode("latin-1")
    for whole in (True, False):
        with contextlib.suppress(RonnaError):
            evaluate(text, {"A": 3, "B": 2.5, "TO": 7}, whole=whole)


def _rsi(reader: TelegramReader) -> Callable[[bytes], object]:
    """What is read must be numbers that the bytes hold."""

    def take(data: bytes) -> None:
        found = reader.read(data)
        assert all(map(isfinite, found.axes_deg))
        assert found.ipoc.isdigit()
        _held((found.ipoc, b"KUKA"), data)

    return take


def _reply(reader: ReplyReader, sentype: bytes) -> Callable[[bytes], object]:
    """Likewise."""

    def take(data: bytes) -> None:
        reply = reader.read(data)
        if reply is None:
            raise InputRefused("no reply")
        assert all(value is None or isfinite(value) for value in reply.values)
        assert 0 <= reply.ipoc < 10**20
        _held((sentype, b"IPOC"), data)

    return take


def _held(parts: tuple[bytes, ...], data: bytes) -> None:
    if not _IN_PIECES.search(data):
        assert all(part in data for part in parts)
