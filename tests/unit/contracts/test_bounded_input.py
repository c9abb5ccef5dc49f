"""Input from outside has a bounded cost and is refused with an error code of our own."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from bounded_cost import bounded_cost
from coded_errors import raises

from drivers.ndi_polaris.errors import BAD_TOOL_FILE
from drivers.ndi_polaris.tool_description import read_description
from procedures.engine.errors import ANSWERS_UNFIT, EVENTS_UNREADABLE
from procedures.engine.events.event_file import FollowedRun
from procedures.imaging.errors import PicksUnreadable
from procedures.imaging.picks import read_picks
from procedures.planning.errors import PLACE_UNFIT, PLAN_UNREADABLE, PlanMistakes
from procedures.planning.plan_file import read_plan
from procedures.planning.proposed_place import read_place
from procedures.reporting.calibration_figures import RESULT_FILE, load_figures
from procedures.runs.answers import read_answers
from ronna_hw.bounded_input import (
    InputRefused,
    inflate,
    parse_json,
    parse_toml,
    parse_toml_bytes,
    parse_xml,
    read_bounded,
)
from ronna_hw.config import BadTheatreFile, read_theatre_file
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import JournalCorrupt, read_chain
from ronna_hw.recording.flight_recorder import read_link
from ronna_hw.records import BadRecord, read_record
from ronna_hw.wire.kuka_context import CONTEXT_INVALID, load_context
from sim.errors import BAD_SCENE
from sim.world.scene.model import read_scene

TOML_FILES = [
    (read_theatre_file, BadTheatreFile),
    (read_scene, BAD_SCENE),
    (read_plan, PLAN_UNREADABLE),
    (load_context, CONTEXT_INVALID),
    (read_description, BAD_TOOL_FILE),
    (read_answers, ANSWERS_UNFIT),
]
HOSTILE_TOML = {
    "a key of many parts": ".".join("a" * 100_000) + " = 1",  # cost fifteen gigabytes
    "a quoted key of many parts": ".".join(['"a b"'] * 1000) + " = 1",
    "a table of many parts": "[" + ".".join("a" * 1000) + "]",
    "nested arrays": "a = " + "[" * 100_000,
    "nested tables": "a = " + "{a = " * 60 + "1" + "}" * 60,
    "many tables": "trajectories = [" + "{}," * 90_000 + "]",  # cost 500 MB
    "many bytes": "# nothing\n" * 100_000,
    "a whole number without end": "a = " + "1" * 100_000,
    "a hexadecimal number without end": "a = 0x" + "f" * 4000,  # too long to be printed
    "a number of 65 bits in a table": f"a = [{{b = {2**63}}}]",
    "a number of 65 bits below zero": f"a = {-(2**63) - 1}",
    "escaped quotes in a string without end": "a = " + '"' + '\\"' * 145_000,  # cost three minutes
    "another encoding": "a = 1".encode("utf-16").decode("latin-1"),
}


@pytest.mark.parametrize(("read", "error"), TOML_FILES, ids=lambda one: getattr(one, "__name__", ""))
@pytest.mark.parametrize("content", HOSTILE_TOML.values(), ids=HOSTILE_TOML)
def test_hostile_toml_is_refused_with_the_code_of_its_reader(
    tmp_path: Path, read: Callable[[Path], Any], error: type[RonnaError], content: str
) -> None:
    path = tmp_path / "hostile.toml"
    path.write_text(content, encoding="latin-1")
    with bounded_cost(100 << 20, 1.0), raises(error, match=r"hostile\.toml"):
        read(path)


def named_pipe(path: Path) -> Path:
    os.mkfifo(path)
    return path


def named_socket(path: Path) -> Path:
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(str(path))
    return path


NO_FILES: dict[str, Callable[[Path], Path]] = {
    "pipe": named_pipe,
    "socket": named_socket,
    "device": lambda _path: Path("/dev/zero"),
}


@pytest.mark.parametrize(
    "read", [read_picks, *(reader for reader, _ in TOML_FILES)], ids=lambda one: one.__name__
)
@pytest.mark.parametrize("made", NO_FILES.values(), ids=NO_FILES)
def test_a_path_that_is_not_a_regular_file_is_refused_without_waiting(
    tmp_path: Path, read: Callable[[Path], Any], made: Callable[[Path], Path]
) -> None:
    path = made(tmp_path / "given.toml")
    with pytest.raises(RonnaError, match=f"{path} is not a regular file"):
        read(path)


def test_a_date_that_no_calendar_has_is_named() -> None:
    with pytest.raises(BadTheatreFile, match=r"2026-13-26 is no date: .*month"):
        parse_toml_bytes(b"expires = 2026-13-26\n", "lab.toml", BadTheatreFile)


@pytest.mark.parametrize(
    ("content", "shown"),
    [
        (b'a = 1\nb = "' + b"x" * 400 + b'" y\nc = 2\n', r'`\.\.\. x+" y`'),
        (b"a = 1\nb = [1,\n2,\n", r"what is not ended began in line 2 or after it: `b = \[1,`"),
        (b"a = 1\rb = c\n", "at line 1, .*: `a = 1 b = c`"),
    ],
    ids=["long line", "not ended", "carriage return"],
)
def test_a_line_that_is_not_toml_is_shown_where_it_is_wrong(content: bytes, shown: str) -> None:
    with pytest.raises(BadTheatreFile, match=shown):
        parse_toml_bytes(content, "lab.toml", BadTheatreFile)


def test_an_unreadable_file_is_named() -> None:
    with pytest.raises(OSError, match="/proc/self/mem"):
        read_bounded(Path("/proc/self/mem"), 100)


def test_valid_toml_with_uids_dotted_keys_and_large_integers_is_accepted() -> None:
    assert parse_toml('series = "1.2.840.10008.5.1.4.1.1.2"\n"a.b".c."d.e" = [[1.5, [2]], {x = {y = 3}}]')
    assert parse_toml(f"a = [{-(2**63)}, {2**63 - 1}]")["a"] == [-(2**63), 2**63 - 1]


HOSTILE_JSON = {
    "brackets": b"[" * 100_000,
    "nested lists": b"[" * 900 + b"1" + b"]" * 900,
    "nested objects": b'{"a":' * 100 + b"1" + b"}" * 100,
    "a number of 400 digits": b"[[" + b"1" * 400 + b",0,0]]",
    "a number beyond all numbers": b"[[1e400,0,0]]",
    "Infinity": b"[[Infinity,0,0]]",
    "NaN": b"[[NaN,0,0]]",
    "many values": b"[" + b"[]," * 1_600_000 + b"0]",
    "escaped quotes in a string without end": b"[" * 65 + b'"' + b'\\"' * 1_000_000,  # cost hours
}


MANY_VALUES = {  # each was a mistake of its own to the model that reads it: five gigabytes, 41 s
    "lists": lambda: b'{"position_mm": [' + b"[]," * 1_000_000 + b"0]}",
    "objects": lambda: b'{"position_mm": [' + b'{"a":1},' * 400_000 + b"0]}",
    "keys": lambda: b"{" + b",".join(b'"%x":1' % number for number in range(400_000)) + b"}",
}


@pytest.mark.parametrize("content", MANY_VALUES.values(), ids=MANY_VALUES)
def test_too_many_values_are_refused_before_the_model_reads_them(
    tmp_path: Path, content: Callable[[], bytes]
) -> None:
    for name in (RESULT_FILE, "place.json", "scene.json"):
        (tmp_path / name).write_bytes(content())
    with bounded_cost(100 << 20, 1.0):
        assert load_figures(tmp_path) is None
        with raises(PLACE_UNFIT, match="too many values"):
            read_place(tmp_path / "place.json")
        with pytest.raises(RonnaError, match="too many values"):
            read_scene(tmp_path / "scene.json")


def test_as_many_mistakes_as_values_are_allowed_have_a_bounded_cost(tmp_path: Path) -> None:
    (tmp_path / "scene.json").write_bytes(b'{"head": {"fiducials": [' + b"{}," * 49_000 + b"{}]}}")
    (tmp_path / "plan.toml").write_text("trajectories = [" + "{}," * 14_900 + "]")
    with bounded_cost():
        with raises(BAD_SCENE, match="more mistakes"):
            read_scene(tmp_path / "scene.json")
        with pytest.raises(PlanMistakes, match="more mistakes"):
            read_plan(tmp_path / "plan.toml")


@pytest.mark.parametrize("content", HOSTILE_JSON.values(), ids=HOSTILE_JSON)
def test_hostile_json_is_refused(content: bytes) -> None:
    with bounded_cost(100 << 20, 1.0), pytest.raises(InputRefused, match="INP-001"):
        parse_json(content)


def test_json_in_another_encoding_whose_brackets_seem_to_be_a_string_is_refused() -> None:
    text = '["\u2278",' + "[" * 500 + "]" * 500 + ',"\u2278"]'
    for encoding in ("utf-16", "utf-16-le", "utf-32-be"):
        with pytest.raises(ValueError, match="not UTF-8"):
            parse_json(text.encode(encoding))


@pytest.mark.parametrize(
    "text", ['"' + "[" * 1000 + '"', '["\\"[[{", ' + "[1], " * 1000 + "{}]", "[" * 60 + "]" * 60]
)
def test_json_whose_brackets_only_appear_deep_is_accepted(text: str) -> None:
    parse_json(text)


@pytest.mark.parametrize("content", HOSTILE_JSON.values(), ids=HOSTILE_JSON)
def test_hostile_picks_are_refused(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "picks.json").write_bytes(content)
    with bounded_cost(100 << 20, 1.0), pytest.raises(PicksUnreadable, match=r"CT-018: picks\.json"):
        read_picks(tmp_path / "picks.json")


@pytest.mark.parametrize(
    "name",
    ["nested lists", "nested objects", "a number of 400 digits", "escaped quotes in a string without end"],
)
def test_hostile_files_in_a_run_are_refused(tmp_path: Path, name: str) -> None:
    content = b'{"entry":' + HOSTILE_JSON[name] + b"}\n"
    for file in ("record.json", "journal.jsonl", "events.jsonl"):
        (tmp_path / file).write_bytes(content)
    with pytest.raises(BadRecord):
        read_record(tmp_path / "record.json")
    with pytest.raises(JournalCorrupt):
        read_chain(tmp_path / "journal.jsonl")
    with raises(EVENTS_UNREADABLE):
        next(FollowedRun(tmp_path).batches())


@pytest.mark.parametrize("size", [3_000_000_000, 300_000_000_000])
def test_huge_sparse_files_in_a_run_are_refused_by_their_size(tmp_path: Path, size: int) -> None:
    for file in ("events.jsonl", "link.a.jsonl.gz"):
        (tmp_path / file).touch()
        os.truncate(tmp_path / file, size)
    with bounded_cost(10 << 20, 1.0):
        with raises(EVENTS_UNREADABLE, match="too large"):
            next(FollowedRun(tmp_path).batches())
        with pytest.raises(InputRefused, match="too large"):
            next(read_link(tmp_path, "link"))


def test_a_file_is_not_read_beyond_its_limit() -> None:
    with (
        bounded_cost(10 << 20, 1.0),
        pytest.raises(InputRefused, match=r"cpuinfo is too large; limit 100 bytes"),
    ):
        read_bounded(Path("/proc/cpuinfo"), 100)  # of size 0 as the file system tells


def test_inflated_data_must_be_complete_and_within_the_limit() -> None:
    for packed in (zlib.compress(bytes(50_000_000)), zlib.compress(b"whole")[:-3], b"no such thing"):
        with bounded_cost(20 << 20, 1.0), pytest.raises(InputRefused, match="deflated data"):
            inflate(packed, 1_000_000)
    assert inflate(zlib.compress(b"whole"), 5) == b"whole"


SUPPORT = Path(__file__).parents[2] / "support" / "command"
LARGE_XML = """
from bounded_cost import bounded_cost
from ronna_hw.bounded_input import parse_xml
large = b"<a b='" + b"x" * 9_000_000 + b"'/>"
with bounded_cost(1 << 20):
    try:
        parse_xml(large, 10_000_000)
    except MemoryError:
        print("no memory")
"""


def test_memory_that_cannot_be_had_is_no_mistake_in_xml() -> None:
    """In a process of its own, which has no freed memory to give."""
    words = [sys.executable, "-c", LARGE_XML]
    paths = os.pathsep.join([str(SUPPORT), *sys.path])
    done = subprocess.run(
        words, env={**os.environ, "PYTHONPATH": paths}, capture_output=True, text=True, check=True
    )
    assert done.stdout == "no memory\n"


@pytest.mark.parametrize(
    "text",
    [
        b'<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>',
        b"<a>" * 1000,
        b"<a/>" + bytes(100),
        b'<?xml version="1.0" encoding="none"?><a/>',
        b"",
    ],
    ids=["entities", "deep", "long", "encoding", "empty"],
)
def test_hostile_xml_is_refused(text: bytes) -> None:
    with pytest.raises(InputRefused):
        parse_xml(text, 100 if text.endswith(b"\0") else 16384)
