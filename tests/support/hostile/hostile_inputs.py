"""Every parser of what comes from outside, with inputs that it takes, and mutants of them.

A parser reads or raises an error of ours; nothing else, and at bounded cost.
"""

from __future__ import annotations

import contextlib
import json
import re
import struct
import tempfile
import time
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from bounded_cost import LIMIT_S
from command_inputs import command_parsers
from conformance_inputs import conformance_parsers
from good_inputs import (
    ANSWERS,
    DESCRIPTION,
    ETHERNET,
    FAULTS,
    FORMULAS,
    PACKET_BYTES,
    PARSER_NAMES,
    REPLIES,
    STATE,
    STRUCTURES,
    TELEGRAM,
    TOOL,
    events_file,
    journal_file,
    packets,
    zipped,
)
from hostile_mutants import mutants
from line_inputs import line_parsers
from more_hostile_inputs import further_parsers
from painted_ct import write_series
from plan_toml import PLAN, SECOND
from pydicom.dataset import Dataset
from pydicom.uid import DeflatedExplicitVRLittleEndian
from run_inputs import run_parsers
from simulator_inputs import simulator_parsers

from console.case_view import RecordedCase
from drivers.basler_stereo import gvcp
from drivers.basler_stereo.features.description import parse_description, parse_url, unzip_description
from drivers.basler_stereo.features.feature_map import FeatureMap
from drivers.basler_stereo.features.formula import evaluate
from drivers.basler_stereo.identity import decode_identity
from drivers.basler_stereo.stream.frame_assembler import FrameAssembler
from drivers.kuka_rsi.eki.client import RECEIVE_BYTES
from drivers.kuka_rsi.eki.telegrams import TelegramScanner, parse_telegram, read_state
from drivers.kuka_rsi.realtime.telegram import TelegramReader
from drivers.ndi_polaris.command_link import open_ascii, split_binary
from drivers.ndi_polaris.measuring_volume import parse_volumes
from drivers.ndi_polaris.replies import decode_bx, decode_tx
from drivers.ndi_polaris.shipped_tools import FOLDER as SHIPPED_TOOLS
from drivers.ndi_polaris.tool_definition import decode_definition
from drivers.ndi_polaris.tool_description import read_description
from procedures.engine.events.event_file import FollowedRun
from procedures.imaging import read_series
from procedures.imaging.picks import read_picks
from procedures.planning.plan_file import read_plan
from procedures.runs.answers import read_answers
from procedures.runs.request import SceneChoice
from procedures.runs.request_file import read_request
from procedures.runs.theatre_note import TheatreNote, read_note
from ronna_hw.bounded_input import InputRefused, parse_json
from ronna_hw.config import read_theatre_file
from ronna_hw.devices.capabilities import Direction
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.evidence.manifest import Seal, read_seal
from ronna_hw.recording.flight_recorder import encode_bytes, encode_note, read_link
from ronna_hw.recording.reading_coding import pack_pixels, unpack_pixels
from ronna_hw.records import Record, read_record, write_record
from ronna_hw.wire import kuka_context, polaris
from ronna_hw.wire.kuka_context import load_context
from sim.kuka.rsi.ethernet_file import read_ethernet_file
from sim.kuka.rsi.telegrams import ReplyReader
from sim.theatre.theatre_file import theatre_content
from sim.world.faults import parse_faults
from sim.world.scene.model import read_scene
from sim.world.scene.named_scenes import named_scene

_IN_PIECES = re.compile(rb"&|<[!?]")  # XML in which a text need not be together


@dataclass(frozen=True)
class Parser:
    """What it is given when all is well, and what takes it; mutants go to `take` as well."""

    good: tuple[bytes, ...]
    take: Callable[[bytes], object]


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
        assembler.overdue(0.01 * number)
    assembler.overdue(1000.0)


def _eki(data: bytes) -> None:
    scanner = TelegramScanner()
    for begin in range(0, len(data), RECEIVE_BYTES):
        for telegram in scanner.feed(data[begin : begin + RECEIVE_BYTES]):
            read_state(parse_telegram(telegram), 0.0)


def _with_right_crc(data: bytes) -> None:
    """The CRC is no secret: who means ill sends the right one."""
    text = data.replace(b"\r", b"")
    for strays in (True, False):
        with contextlib.suppress(RonnaError):
            reply = decode_tx(open_ascii(text + b"%04X" % polaris.crc16(text)), strays=strays)
            positions = [report.position_mm for report in reply.handles if report.position_mm is not None]
            assert all(isfinite(value) for position in positions for value in position)
    with contextlib.suppress(RonnaError):
        parse_volumes(open_ascii(text + b"%04X" % polaris.crc16(text)))


def _binary(data: bytes) -> None:
    with contextlib.suppress(RonnaError):
        split_binary(data)
    with contextlib.suppress(RonnaError):
        assert len(decode_bx(data, strays=False).handles) == data[0]
    assert len(decode_bx(data).handles) == data[0]


def _rom(data: bytes) -> None:
    block = bytearray(data.ljust(752, b"\0")[:752])
    struct.pack_into("<H", block, 4, sum(block[6:]) & 0xFFFF)  # a right checksum
    with contextlib.suppress(RonnaError):
        decode_definition(bytes(block))
    decode_definition(data)


def _pixels(data: bytes) -> None:
    with contextlib.suppress(ValueError):
        unpack_pixels(data, (30, 40), "uint16")


def parsers(folder: Path) -> dict[str, Parser]:
    """All of them by name; those of files read from `folder`."""

    def of_file(name: str, read: Callable[[Path], object]) -> Callable[[bytes], object]:
        path = folder / name

        def take(data: bytes) -> object:
            path.write_bytes(data)
            return read(path)

        return take

    def of_run(name: str, read: Callable[[Path], object]) -> Callable[[bytes], object]:
        run = folder / name.replace(".", "-")
        run.mkdir(exist_ok=True)

        def take(data: bytes) -> object:
            (run / name).write_bytes(data)
            return read(run)

        return take

    scene = named_scene("mini")
    plain_scene = scene.model_dump_json(by_alias=True).encode()
    endpoints = {
        "polaris": "tcp://127.0.0.1:1",
        "kuka": {"rsi": "udp://127.0.0.1:2", "eki_project": "tcp://127.0.0.1:3"},
        "basler": {"left": "gev://127.0.0.1", "right": "gev://127.0.0.2"},
    }
    theatre = tomli_w.dumps(
        theatre_content(scene, endpoints, "host:", {"robot_frame": "robot_frame.rom"}, 2.0)
    )
    record = write_record(
        Record("1-plan", "plan", {"0-ct": "0" * 64}, {"a": [1.5, {"b": None}], "c": "text"}), folder
    ).read_bytes()
    request = json.dumps(
        {"schema": 1, "program": version("ronna-hw"), "scene": "mini", "strategy": "ocs", "speed": "max"}
    )
    sealed = Seal(journal_bytes=9, journal_sha256="0" * 64, files={"log.jsonl": "1" * 64}).with_own_hash()
    seal = sealed.model_dump_json(by_alias=True, indent=1).encode()
    context = Path(kuka_context.__file__).with_name(kuka_context.DEFAULT_CONTEXT_FILE).read_bytes()
    ours = load_context()
    sentype = ours.ethernet.sentype.encode()
    lines = encode_bytes(1_800_000_000_000_000_000, 1.25, Direction.SENT, b"AP") + encode_note(
        0, 1.0, {"a": "b"}
    )
    voxels = np.arange(3 * 6 * 7, dtype=np.int16).reshape(3, 6, 7) - 1000
    series = write_series(folder / "series", voxels)
    deflated = write_series(folder / "deflated", voxels, edit=_deflated)

    def slices(where: Path) -> Callable[[bytes], object]:
        return of_file(f"{where.name}/0000.dcm", lambda _path: read_series(where))

    def link(path: Path) -> object:
        return list(read_link(path, "link"))

    def events(path: Path) -> object:
        recorded = RecordedCase()
        for batch in FollowedRun(path).batches(whole=True):
            recorded.extend(batch)
        return recorded.latest

    bx = (
        struct.pack("<3B8f2IBBH", 1, 2, 1, 1.0, 0, 0, 0, 10.0, -20.0, -1500.0, 0.1, 0x31, 300, 0, 0, 0)[:46],
        struct.pack("<3B2I2BBB3fH", 2, 1, 2, 0x31, 301, 2, 4, 1, 0, 10.0, -20.0, -1500.0, 0),
    )
    tx = (
        b"0102+10000+00000+00000+00000+001050-002025-150000+0012500000031" + b"0000012C\n000000",
        b"0101MISSING000000310000012D\n033+001000+002000-150000-001000-002000-250000+000000+000000-1000000002",
    )
    whole_plan = (PLAN + SECOND).encode()
    found = {
        "theatre TOML": Parser((theatre.encode(),), of_file("theatre.toml", read_theatre_file)),
        "scene TOML": Parser(
            (tomli_w.dumps(_without_none(json.loads(plain_scene))).encode(),),
            of_file("scene.toml", read_scene),
        ),
        "scene JSON": Parser((plain_scene,), of_file("scene.json", read_scene)),
        "scene's seed": Parser(
            (b'{"seed": 5}', b"seed = 5"),
            of_file("seed.json", lambda path: SceneChoice(str(path)).own_seed),
        ),
        "plan TOML": Parser((whole_plan, whole_plan + STRUCTURES), of_file("plan.toml", read_plan)),
        "context TOML": Parser((context,), of_file("context.toml", load_context)),
        "tool TOML": Parser((TOOL,), of_file("tool.toml", lambda path: read_description(path).definition())),
        "answers TOML": Parser((ANSWERS,), of_file("answers.toml", read_answers)),
        "picks JSON": Parser(
            (
                b"[[1.5, -2, 3e1]]",
                b'{"spheres": [{"centre_mm": [1, 2, 3]}]}',
                b'{"markups":[{"coordinateSystem":"RAS","controlPoints":[{"position":[1,2,3]}]}]}',
            ),
            of_file("picks.json", read_picks),
        ),
        "picks CSV": Parser((b"L_mm,P_mm,S_mm\n1,2,3\n", b"# a\n1,2,3\n"), of_file("picks.csv", read_picks)),
        "record": Parser((record,), of_file("record.json", read_record)),
        "journal": Parser((journal_file(),), of_file("journal.jsonl", read_chain)),
        "events": Parser((events_file(),), of_run("events.jsonl", events)),
        "theatre in use": Parser(
            (TheatreNote(run=folder / "a", pid=7, moved_before=folder / "b").model_dump_json().encode(),),
            of_file("in-use", lambda path: read_note(path).settled()),
        ),
        "seal": Parser((seal,), of_run("seal.json", read_seal)),
        "request": Parser((request.encode(),), of_run("request.json", read_request)),
        "recorded bytes": Parser((lines.encode(),), of_run("link.a.jsonl", link)),
        "recorded pixels": Parser((pack_pixels(np.zeros((30, 40), np.uint16)),), _pixels),
        "control line": Parser((b'{"do": "fault", "line": "now: x"}',), _control),
        "fault script": Parser((FAULTS,), lambda data: parse_faults(data.decode("utf-8", "replace"))),
        "GenICam XML": Parser((DESCRIPTION,), _features),
        "GenICam ZIP": Parser(
            (zipped(DESCRIPTION), zipped(DESCRIPTION, zipfile.ZIP_STORED)), unzip_description
        ),
        "GenICam formula": Parser(FORMULAS, _formula),
        "GVCP": Parser(
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
        "GVSP": Parser((packets(),), _gvsp),
        "Polaris BX": Parser(bx, _binary),
        "Polaris text": Parser(
            (
                *tx,
                b"15-000240000-000095000-000055700+000015200+000031100+000035600+000041400+000049500+000078300+000093500",
            ),
            _with_right_crc,
        ),
        "Polaris .rom": Parser(((SHIPPED_TOOLS / "robot_frame.rom").read_bytes(),), _rom),
        "EKI": Parser((STATE, STATE + b"\0\r\n" + STATE), _eki),
        "RSI": Parser((TELEGRAM,), _rsi(TelegramReader(("DEF_RIst", "DEF_AIPos", "DEF_EIPos", "DEF_Delay")))),
        "RSI reply": Parser(
            tuple(reply.replace(b"RONNA", sentype) for reply in REPLIES),
            _reply(ReplyReader(ours.receive, ours.ethernet.sentype), sentype),
        ),
        "Ethernet file": Parser(
            (ETHERNET,), of_file("e.xml", lambda path: read_ethernet_file(path, None, 255))
        ),
        "DICOM": Parser(((series / "0000.dcm").read_bytes(),), slices(series)),
        "DICOM deflated": Parser(((deflated / "0000.dcm").read_bytes(),), slices(deflated)),
    }
    for more in (
        further_parsers(folder / "further"),
        simulator_parsers(),
        command_parsers(folder / "commands"),
        run_parsers(folder / "runs"),
        conformance_parsers(),
        line_parsers(folder / "lines"),
    ):
        found |= {name: Parser(*one) for name, one in more.items()}
    assert tuple(found) == PARSER_NAMES
    return found


def _control(data: bytes) -> None:
    with contextlib.suppress(ValueError):
        parse_json(data)


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


def _deflated(data: Dataset, _number: int) -> None:
    data.file_meta.TransferSyntaxUID = DeflatedExplicitVRLittleEndian


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(part) for key, part in value.items() if part is not None}
    return [_without_none(part) for part in value] if isinstance(value, list) else value


def feed(parser: Parser, count: int, seed: int) -> int:
    """Feed mutants, each at bounded cost; returns how many were taken. Raises what is no error of ours."""
    return sum(taken(parser, data) for data in mutants(parser.good, count, seed))


def taken(parser: Parser, data: bytes) -> bool:
    """Whether it was read, at bounded cost, and not refused. Raises what is no error of ours."""
    begun_s = time.thread_time()
    try:
        parser.take(data)
        read = True
    except RonnaError as error:
        if not error.code or _memory_could_not_be_had(error):
            raise AssertionError(f"{error!r} for {data[:200]!r}, {len(data)} bytes") from error
        read = False
    except Exception as error:
        kept = Path(tempfile.gettempdir()) / "hostile_input.bin"
        kept.write_bytes(data)
        raise AssertionError(f"{error!r} for {data[:200]!r}, {len(data)} bytes, kept in {kept}") from error
    spent_s = time.thread_time() - begun_s
    assert spent_s < LIMIT_S, f"{spent_s:.1f} s for {data[:200]!r}"
    return read


def _memory_could_not_be_had(error: BaseException | None) -> bool:
    """A refusal because of the harness's bound is no refusal: elsewhere the memory would have been had."""
    while error is not None:
        if isinstance(error, MemoryError):
            return True
        error = error.__cause__ or error.__context__
    return False
