"""Every parser of what comes from outside, with inputs that it takes, and mutants of them.

A parser reads or raises an error of ours; nothing else, and at bounded cost.
"""

from __future__ import annotations

import contextlib
import gzip
import json
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from bounded_cost import LIMIT_S
from command_inputs import command_parsers
from conformance_inputs import conformance_parsers
from driver_inputs import driver_parsers
from good_inputs import (
    ANSWERS,
    ETHERNET,
    FAULTS,
    PARSER_NAMES,
    STRUCTURES,
    TOOL,
    Take,
    events_file,
    journal_file,
    reading,
)
from line_inputs import line_parsers
from mutations import mutants
from painted_ct import write_series
from plan_toml import PLAN, SECOND
from pydicom.dataset import Dataset
from pydicom.uid import DeflatedExplicitVRLittleEndian
from record_inputs import record_parsers
from run_inputs import run_parsers
from simulator_inputs import simulator_parsers

from console.recorded_case import RecordedCase
from drivers.ndi_polaris.tool_description import read_description
from procedures.engine.events.event_file import FollowedRun
from procedures.imaging import read_series
from procedures.imaging.picks import read_picks
from procedures.planning.plan_file import read_plan
from procedures.runs.answers import read_answers
from procedures.runs.arm_notes import TheatreNote, read_note
from procedures.runs.request import SceneChoice
from procedures.runs.request_file import read_request
from ronna_hw.bounded_input import parse_json
from ronna_hw.config import read_theatre_file
from ronna_hw.devices.capabilities import Direction
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import read_chain
from ronna_hw.evidence.manifest import RunSeal, read_seal
from ronna_hw.recording.flight_recorder import encode_bytes, encode_note, read_link
from ronna_hw.recording.reading_coding import pack_pixels, unpack_pixels
from ronna_hw.records import Record, read_record, write_record
from ronna_hw.wire import kuka_context
from ronna_hw.wire.kuka_context import load_context
from sim.kuka.rsi.ethernet_file import read_ethernet_file
from sim.theatre.theatre_file import theatre_content
from sim.world.faults import parse_faults
from sim.world.scene.model import read_scene
from sim.world.scene.named_scenes import draw_scene


@dataclass(frozen=True)
class Parser:
    """What it is given when all is well, and what takes it; mutants go to `take` as well."""

    good: tuple[bytes, ...]
    take: Take


def _pixels(data: bytes) -> None:
    with contextlib.suppress(ValueError):
        unpack_pixels(data, (30, 40), "uint16")


def parsers(folder: Path) -> dict[str, Parser]:
    """All of them by name; those of files read from `folder`."""

    def of_file(name: str, read: Callable[[Path], object]) -> Take:
        return reading(folder / name, read)

    def of_run(name: str, read: Callable[[Path], object]) -> Take:
        run = folder / name.replace(".", "-")
        run.mkdir(exist_ok=True)
        return reading(run / name, lambda _path: read(run))

    scene = draw_scene("mini")
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
    sealed = RunSeal(journal_bytes=9, journal_sha256="0" * 64, files={"log.jsonl": "1" * 64}).with_own_hash()
    seal = sealed.model_dump_json(by_alias=True, indent=1).encode()
    context = Path(kuka_context.__file__).with_name(kuka_context.DEFAULT_CONTEXT_FILE).read_bytes()
    lines = encode_bytes(1_800_000_000_000_000_000, 1.25, Direction.SENT, b"AP") + encode_note(
        0, 1.0, {"a": "b"}
    )
    voxels = np.arange(3 * 6 * 7, dtype=np.int16).reshape(3, 6, 7) - 1000
    series = write_series(folder / "series", voxels)
    deflated = write_series(folder / "deflated", voxels, edit=_deflated)

    def slices(where: Path) -> Take:
        return of_file(f"{where.name}/0000.dcm", lambda _path: read_series(where))

    def link(path: Path) -> object:
        return list(read_link(path, "link"))

    def events(path: Path) -> object:
        recorded = RecordedCase()
        for batch in FollowedRun(path).batches(whole=True):
            recorded.extend(batch)
        return recorded.latest

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
            of_file("seed.json", lambda path: SceneChoice(str(path)).scene_seed),
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
            of_file("in-use", lambda path: read_note(path).with_outcome()),
        ),
        "seal": Parser((seal,), of_run("seal.json", read_seal)),
        "request": Parser((request.encode(),), of_run("request.json", read_request)),
        "recorded bytes": Parser(
            (lines.encode(),), lambda data: of_run("link.a.jsonl.gz", link)(gzip.compress(data, mtime=0))
        ),
        "packed bytes": Parser((gzip.compress(lines.encode(), mtime=0),), of_run("link.a.jsonl.gz", link)),
        "recorded pixels": Parser((pack_pixels(np.zeros((30, 40), np.uint16)),), _pixels),
        "control line": Parser((b'{"do": "fault", "line": "now: x"}',), _control),
        "fault script": Parser((FAULTS,), lambda data: parse_faults(data.decode("utf-8", "replace"))),
        "Ethernet file": Parser(
            (ETHERNET,), of_file("e.xml", lambda path: read_ethernet_file(path, None, 255))
        ),
        "DICOM": Parser(((series / "0000.dcm").read_bytes(),), slices(series)),
        "DICOM deflated": Parser(((deflated / "0000.dcm").read_bytes(),), slices(deflated)),
    }
    for more in (
        driver_parsers(),
        record_parsers(folder / "further"),
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
    began_s = time.thread_time()
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
    spent_s = time.thread_time() - began_s
    assert spent_s < LIMIT_S, f"{spent_s:.1f} s for {data[:200]!r}"
    return read


def _memory_could_not_be_had(error: BaseException | None) -> bool:
    """A refusal because of the harness's bound is no refusal: elsewhere the memory would have been had."""
    while error is not None:
        if isinstance(error, MemoryError):
            return True
        error = error.__cause__ or error.__context__
    return False
