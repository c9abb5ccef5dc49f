"""No ten-megabyte input, however crafted, costs a parser more than 300 MB or five seconds."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Iterator

import pytest
from bounded_cost import bounded_cost
from good_inputs import PARSER_NAMES
from hostile_inputs import Parser, parsers
from memory_folder import memory_folder

from drivers.ndi_polaris.command_link import LONGEST_REPLY_BYTES
from ronna_hw.control_port import LONGEST_LINE
from ronna_hw.errors import RonnaError
from ronna_hw.evidence.journal_reading import FIRST
from sim.polaris.line.server import RECEIVE_BYTES
from sim.world.client_sockets import READ_BYTES

pytestmark = [pytest.mark.slow, pytest.mark.timeout(600)]

SIZE_BYTES = 10_000_000
LONGEST_VARIABLE_BYTES = 131_072  # that Linux gives to a process
DATAGRAM_BYTES = 65_507  # the largest of UDP
AT_MOST = {  # what the link itself hands over at a time
    **dict.fromkeys(("GVCP", "GVSP", "RSI", "RSI reply", "simulated camera"), DATAGRAM_BYTES),
    "conformance stream": DATAGRAM_BYTES,
    "variables": LONGEST_VARIABLE_BYTES,
    **dict.fromkeys(("EKI request", "EKI SDK request"), READ_BYTES),
    "simulated tracker": RECEIVE_BYTES,
    **dict.fromkeys(("control port", "control port answer"), LONGEST_LINE),
    **dict.fromkeys(
        (
            *("Polaris text", "Polaris BX", "Polaris handles", "Polaris identity"),
            *("conformance BX", "conformance Polaris"),
        ),
        LONGEST_REPLY_BYTES,
    ),
}


def filled(part: bytes) -> bytes:
    """That many bytes of it."""
    return (part * (SIZE_BYTES // len(part) + 1))[:SIZE_BYTES]


def with_long_middle(good: bytes, part: bytes) -> bytes:
    """What is good, with a part of it as long as the rest allows."""
    half = len(good) // 2
    return good[:half] + filled(part)[len(good) :] + good[half:]


WORST: dict[str, Callable[[bytes], bytes]] = {
    "zeros": lambda _good: filled(b"\0"),
    "ones": lambda _good: filled(b"\xff"),
    "brackets": lambda _good: filled(b"["),
    "braces": lambda _good: filled(b'{"a":'),
    "elements": lambda _good: filled(b"<a>"),
    "digits": lambda _good: filled(b"1"),
    "minus signs": lambda _good: filled(b"-"),
    "empty lines": lambda _good: filled(b"\n"),
    "parts of a key": lambda _good: filled(b"a."),
    "quotes": lambda _good: filled(b'"'),
    "escaped quotes in a string without end": lambda _good: b"[" * 65 + b'"' + filled(b'\\"')[66:],
    "keys": lambda _good: b"{" + b",".join(b'"%x":1' % number for number in range(SIZE_BYTES // 10)) + b"}",
    "lists": lambda _good: b"[" + b"[]," * (SIZE_BYTES // 3 - 1) + b"1]",
    "fewer lists": lambda _good: b"[" + b"[]," * 600_000 + b"1]",
    "what is good, again and again": filled,
    "lines of what is good": lambda good: filled(good + b"\n"),
    "long in the middle": lambda good: with_long_middle(good, b"a"),
    "digits in the middle": lambda good: with_long_middle(good, b"9"),
    "its own middle": lambda good: with_long_middle(good, good[len(good) // 3 : 2 * len(good) // 3] or b"a"),
    "a hole in the middle": lambda good: with_long_middle(good, b" "),
}


@pytest.fixture(scope="module")
def all_parsers(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, Parser]]:
    with memory_folder(tmp_path_factory.mktemp("large")) as folder:
        yield parsers(folder)


@pytest.mark.parametrize("name", PARSER_NAMES)
def test_ten_megabytes_have_a_bounded_cost(all_parsers: dict[str, Parser], name: str) -> None:
    parser = all_parsers[name]
    for worst, made in WORST.items():
        data = made(parser.good[0])[: AT_MOST.get(name)]
        try:
            with bounded_cost(), contextlib.suppress(RonnaError):
                parser.take(data)
        except (AssertionError, MemoryError) as error:
            raise AssertionError(f"{name}, {worst}: {error!r}") from error


DENSE = {
    "deep objects": '{"":' * 50 + "0" + "}" * 50,
    "deep lists": "[" * 50 + "]" * 50,
    "objects": '{"":0}',
    "lists": "[0]",
}
OF_A_LINE_BYTES = 20_000
LINES = {  # the number of a good line, and the way to the value that something dense takes the place of
    "events": (-1, ("what", "line", "values")),
    "journal": (0, ("values",)),
    "run": (0, ("truth",)),
    "log": (0, ("a",)),
    "tape": (1, ("answer",)),
}


def dense_lines(good: bytes, name: str, unit: str, size_bytes: int) -> bytes:
    """The good line again and again, with many of the unit in it; after the first, if that is another."""
    number, way = LINES[name]
    first, *_ = lines = good.splitlines(keepends=True)
    inner = whole = json.loads(lines[number])
    for key in way[:-1]:
        inner = inner[key]
    inner[way[-1]] = "@"
    text = json.dumps(whole).replace('"@"', f"[{','.join([unit] * (OF_A_LINE_BYTES // len(unit)))}]")
    content, previous = first if number > 0 else b"", FIRST
    parts = [content]
    for sequence in range(size_bytes // len(text)):
        chained = text.replace(f'"previous": "{FIRST}"', f'"previous": "{previous}"')
        line = chained.replace('"sequence": 0,', f'"sequence": {sequence},').encode() + b"\n"
        previous = hashlib.sha256(line).hexdigest()
        parts.append(line)
    return b"".join(parts)


@pytest.mark.parametrize("size_bytes", [SIZE_BYTES, SIZE_BYTES // 2], ids=["beyond bounds", "nearly within"])
@pytest.mark.parametrize("unit", DENSE.values(), ids=DENSE)
@pytest.mark.parametrize("name", LINES)
def test_lines_of_nested_values_have_a_bounded_cost(
    all_parsers: dict[str, Parser], name: str, unit: str, size_bytes: int
) -> None:
    data = dense_lines(all_parsers[name].good[0], name, unit, size_bytes)
    with bounded_cost(), contextlib.suppress(RonnaError):
        all_parsers[name].take(data)


@pytest.mark.parametrize("size_bytes", [SIZE_BYTES, SIZE_BYTES // 4, SIZE_BYTES // 5])
@pytest.mark.parametrize("unit", DENSE.values(), ids=DENSE)
def test_a_record_of_nested_values_has_a_bounded_cost(
    all_parsers: dict[str, Parser], unit: str, size_bytes: int
) -> None:
    good = json.loads(all_parsers["record"].good[0])
    text = json.dumps({**good, "payload": "@"}).replace('"@"', '{"a": [@]}')
    data = text.replace("@", ",".join([unit] * (size_bytes // (len(unit) + 1)))).encode()
    with bounded_cost(), contextlib.suppress(RonnaError):
        all_parsers["record"].take(data)
