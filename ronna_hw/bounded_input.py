"""Bounds on external input, checked before use: size, depth, count, expansion.

A file, a reply or a datagram may be damaged or malicious; a few bytes must not cost gigabytes or minutes.
Everything here raises INP-001, also a ValueError: the reader of a format can refuse with its own code.

- Files are read only up to their bound: the size reported by the file system may be wrong or missing.
- JSON has a limited number of values, limited depth, and finite numbers. The limits are checked on the text:
  a parsed document is up to thirty times as large.
- TOML has keys of a limited number of parts and whole numbers of 64 bits. The standard library stores every
  prefix of a key: its memory grows with the square of the parts.
- Deflated data and ZIP files are unpacked only up to a limit.
- XML has no document type, which could declare entities, and a limited number of elements and names.
"""

from __future__ import annotations

import errno
import io
import json
import math
import os
import re
import struct
import tomllib
import zipfile
import zlib
from collections.abc import Callable, Iterator
from datetime import date
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.parsers.expat import errors

from ronna_hw.errors import DataError, RonnaError
from ronna_hw.host.files import open_regular


class InputRefused(DataError):
    """External input exceeds plausible bounds: too large, too deep or too dense."""

    code = "INP-001"
    action = "Find out where it comes from; files written by these programs are far below the limit."


FILE_ADVICE = "Give a file: pipes, sockets and devices are not read."


def read_bounded(
    path: Path, limit_bytes: int, *, follow_links: bool = True, start_bytes: int | None = None
) -> bytes:
    """Read a file, or only its first `start_bytes`. Raises OSError, and INP-001 above `limit_bytes`.

    Never blocks: a pipe, socket or device in its place is refused, and without `follow_links` also a link
    (OSError).
    """
    try:
        with open_regular(path, follow_links=follow_links) as file:
            if start_bytes is not None and start_bytes < os.fstat(file.fileno()).st_size <= limit_bytes:
                return file.read(start_bytes)
            content = file.read(limit_bytes + 1)
    except OSError as error:
        if follow_links and error.errno in (errno.EINVAL, errno.ENXIO):  # the second for a socket
            raise InputRefused(f"{path} is not a regular file", action=FILE_ADVICE) from error
        error.filename = error.filename or str(path)  # errors while reading do not name the file
        raise
    if len(content) > limit_bytes:
        raise InputRefused(f"{path.name} is too large", limit=f"{limit_bytes} bytes")
    return content


LARGEST_JSON_BYTES = 100_000_000  # a case's journal has a hundredth of it
MOST_VALUES = 2_000_000  # up to 120 bytes each in memory
MOST_VALUES_OF_A_MODEL = 100_000  # two are an empty object, whose missing fields take four kilobytes
MOST_VALUES_OF_LINES = 2_000_000  # of which a case's tape of readings has a tenth
DEEPEST = 64  # records nest about ten deep
MOST_DIGITS = 20  # of an integer: nanoseconds since 1970 have 19

# An escaped quote begins no string; if it could, one without an end would be scanned from each quote in it.
_STRING = re.compile(rb'(?<!\\)"(?:[^"\\]|\\.)*+"', re.DOTALL)
_NO_BRACKETS = re.compile(rb"[^\[\]{}]+")


def parse_json(text: bytes | str, limit_bytes: int = LARGEST_JSON_BYTES) -> Any:
    """Parse JSON text. Raises INP-001, and ValueError for invalid JSON."""
    content = check_json(text.encode() if isinstance(text, str) else text, limit_bytes, MOST_VALUES)
    if b"\0" in content:  # as in every other encoding, whose depth is not seen
        raise ValueError("JSON that is not UTF-8")
    try:
        return json.loads(content, parse_int=_parse_whole, parse_float=_finite, parse_constant=_finite)
    except RecursionError as error:  # from brackets that never close
        raise InputRefused("JSON nested too deep", limit=f"{DEEPEST} levels") from error


def read_json_bytes(
    path: Path,
    limit_bytes: int = LARGEST_JSON_BYTES,
    most_values: int = MOST_VALUES_OF_A_MODEL,
    *,
    follow_links: bool = True,
) -> bytes:
    """Read a JSON file as bytes for validation by a model; `follow_links` as in `read_bounded`.

    Raises INP-001, OSError.
    """
    return check_json(read_bounded(path, limit_bytes, follow_links=follow_links), limit_bytes, most_values)


def read_json_lines(path: Path, limit_bytes: int = LARGEST_JSON_BYTES, *, follow_links: bool = True) -> bytes:
    """Read a JSON Lines file whose last line may be truncated; `follow_links` as in `read_bounded`.

    Raises INP-001, OSError.
    """
    return _check_count(read_bounded(path, limit_bytes, follow_links=follow_links), MOST_VALUES_OF_LINES)


def check_json(
    content: bytes, limit_bytes: int = LARGEST_JSON_BYTES, most_values: int = MOST_VALUES_OF_A_MODEL
) -> bytes:
    """Check JSON bytes against the limits and return them; raises INP-001. Numeric values are not checked."""
    if len(content) > limit_bytes:
        raise InputRefused("the JSON is too large", limit=f"{limit_bytes} bytes", got=f"{len(content)}")
    _check_count(content, most_values)
    if content.count(b"[") + content.count(b"{") > DEEPEST and _is_too_deep(content):
        raise InputRefused("JSON nested too deep", limit=f"{DEEPEST} levels")
    return content


def _check_count(content: bytes, most_values: int) -> bytes:
    if count_values(content) > most_values:
        raise InputRefused("too many values in JSON", limit=f"{most_values} values")
    return content


def count_values(content: bytes) -> int:
    """Return an upper bound on the number of values in a JSON text."""
    return sum(content.count(mark) for mark in (b"[", b"{", b",", b":"))


def _is_too_deep(content: bytes) -> bool:
    """Return whether brackets nest too deeply, stripping the innermost pairs once per allowed level."""
    brackets = _NO_BRACKETS.sub(b"", _STRING.sub(b"", content))
    for _ in range(DEEPEST):
        if not brackets:
            return False
        brackets = brackets.replace(b"[]", b"").replace(b"{}", b"")
    return bool(brackets)


def _parse_whole(digits: str) -> int:
    if len(digits) > MOST_DIGITS:
        raise InputRefused("a whole number in JSON has too many digits", limit=f"{MOST_DIGITS} digits")
    return int(digits)


def _finite(number: str) -> float:
    """Parse a fractional number; raises INP-001 if it is not finite."""
    value = float(number)
    if not math.isfinite(value):
        raise InputRefused("a number in JSON that is not finite", got=number[:MOST_DIGITS])
    return value


LARGEST_TOML_BYTES = 300_000  # a plan with a hundred trajectories has twenty thousand
WHOLE = range(-(2**63), 2**63)  # as TOML requires; a long hexadecimal number cannot even be printed
MOST_TOML_VALUES = 30_000  # a plan with all the points that it may have has twelve thousand
DEEPEST_TOML = 32  # nested tables and parts of a key; more parts than a DICOM identifier can have

_PART = r"(?:[A-Za-z0-9_-]++|\"(?:[^\"\\\n]|\\.)*+\"|'[^'\n]*+')"
# Not from an escaped quote: a string without an end would be scanned from each quote in it.
_LONG_KEY = re.compile(rf"(?<![A-Za-z0-9_\-\\]){_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{{DEEPEST_TOML}}}")

LONGEST_SHOWN = 80  # characters of a line with a mistake
_LINE_NUMBER = re.compile(r"\(at line (\d+), column (\d+)\)")
_BEGINS_KEY = re.compile(r"\s*[\w\"'.-]+\s*=|\s*\[\[?[\w\"'. -]+\]\]?\s*(#.*)?$")
_DECIMAL_COMMA = re.compile(r"=\s*[-+]?\d+,\d+\s*(#.*)?$")
_WRITTEN_AS_DATE = re.compile(r"=\s*(\d{4}-\d{2}-\d{2})")
_LIKE_A_DATE = re.compile(r"=\s*\d{1,2}[./]\d{1,2}[./]\d{4}")


def read_toml(path: Path, refusal: Callable[[str], RonnaError]) -> dict[str, Any]:
    """Read a TOML file; raises OSError, and `refusal` with the reason for invalid or oversized TOML."""
    try:
        content = read_bounded(path, LARGEST_TOML_BYTES)
    except InputRefused as error:
        raise refusal(f"{path.name} is refused: {error.summary}") from error
    return parse_toml_bytes(content, path.name, refusal)


def parse_toml_bytes(content: bytes, name: str, refusal: Callable[[str], RonnaError]) -> dict[str, Any]:
    """Parse the bytes of the TOML file `name`; raises `refusal` like `read_toml`."""
    if b"\0" in content:
        raise refusal(
            f"{name} is not TOML: it is binary or UTF-16, with a zero byte at {content.index(0)}; "
            "save it as UTF-8 text"
        )
    try:
        return parse_toml(content.decode("utf-8-sig"))
    except InputRefused as error:
        raise refusal(f"{name} is refused: {error.summary}") from error
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        line_began = content.rfind(b"\n", 0, error.start) + 1
        shown = content[line_began:].split(b"\n")[0].decode(errors="replace")
        column = len(content[line_began : error.start].decode(errors="replace")) + 1
        raise refusal(
            f"{name} is not TOML: it is not UTF-8 text (at line {line}, byte 0x{content[error.start]:02x}): "
            f"`{_cut_line(shown, column)}`; save it as UTF-8"
        ) from error
    except ValueError as error:
        raise refusal(f"{name} is not TOML: {error}{_describe_line(error, content)}") from error


def _describe_line(error: ValueError, content: bytes) -> str:
    """Quote the line that failed to parse, with a hint if it resembles a date or a decimal.

    What is still open at the end of the document began in the last line with a key, or after it.
    """
    lines = content.decode("utf-8-sig").split("\n")
    found = _LINE_NUMBER.search(str(error))
    if found is None:
        opened = [number for number, line in enumerate(lines, 1) if _BEGINS_KEY.match(line)]
        if not opened:
            return ""
        shown = _cut_line(lines[opened[-1] - 1], 1)
        return f"; what is not ended began in line {opened[-1]} or after it: `{shown}`"
    line = lines[int(found[1]) - 1]
    writing_advice = "; a date is written 2026-12-31" if _LIKE_A_DATE.search(line) else ""
    writing_advice = "; decimals have a point, not a comma" if _DECIMAL_COMMA.search(line) else writing_advice
    if (written := _WRITTEN_AS_DATE.search(line)) is not None:
        try:
            date.fromisoformat(written[1])
        except ValueError as wrong:
            writing_advice = f"; {written[1]} is no date: {wrong}"
    return f": `{_cut_line(line, int(found[2]))}`{writing_advice}"


def _cut_line(line: str, column: int) -> str:
    """Cut a line to what can be shown, with its column (counted from 1) in it and dots where it was cut."""
    begin = max(0, min(column - 1 - LONGEST_SHOWN // 2, len(line) - LONGEST_SHOWN))
    end = begin + LONGEST_SHOWN
    dots = ("... " if begin else "", " ..." if end < len(line) else "")
    return f"{dots[0]}{line[begin:end].strip()}{dots[1]}"


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML text. Raises INP-001, and ValueError for invalid TOML."""
    if len(text) > LARGEST_TOML_BYTES:
        raise InputRefused("too much TOML", limit=f"{LARGEST_TOML_BYTES} bytes")
    if sum(map(text.count, "[{,=")) > MOST_TOML_VALUES:  # a model may find several mistakes in each
        raise InputRefused("too many values in TOML", limit=f"{MOST_TOML_VALUES} values")
    if _LONG_KEY.search(text):
        raise InputRefused("a key with too many parts", limit=f"{DEEPEST_TOML} parts")
    try:
        content = tomllib.loads(text)
    except RecursionError as error:
        raise InputRefused("TOML nested too deep", limit=f"{DEEPEST_TOML} levels") from error
    level: list[Any] = [content]
    for _ in range(DEEPEST_TOML):
        inside = [inner for outer in level for inner in _iterate_values(outer)]
        if any(isinstance(value, int) and value not in WHOLE for value in inside):
            raise InputRefused("a whole number in TOML is too large", limit="64 bits, signed")
        if not (level := [inner for inner in inside if isinstance(inner, dict | list)]):
            return content
    raise InputRefused("TOML nested too deep", limit=f"{DEEPEST_TOML} levels")


def _iterate_values(value: Any) -> Iterator[Any]:
    return iter(value.values() if isinstance(value, dict) else value)


LARGEST_ZIP_BYTES = 2_000_000  # its table of contents is read entirely
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # only these can be unpacked incrementally


def inflate(packed: bytes, limit_bytes: int, *, raw: bool = False) -> bytes:
    """Inflate zlib data, or raw deflate data if `raw`. Raises INP-001 for oversized or damaged data."""
    unpacker = zlib.decompressobj(-zlib.MAX_WBITS if raw else zlib.MAX_WBITS)
    try:
        content = unpacker.decompress(packed, limit_bytes + 1)
    except zlib.error as error:
        raise InputRefused(f"deflated data are damaged: {error}") from error
    if len(content) > limit_bytes:
        raise InputRefused("deflated data expand beyond the limit", limit=f"{limit_bytes} bytes")
    if not unpacker.eof:
        raise InputRefused("deflated data are truncated")
    return content


def unzip(packed: bytes, limit_bytes: int) -> bytes:
    """Unpack the first member of a ZIP file (stored or deflated). Raises INP-001 if oversized or damaged."""
    if len(packed) > LARGEST_ZIP_BYTES:
        raise InputRefused("a ZIP file is too large", limit=f"{LARGEST_ZIP_BYTES} bytes")
    try:
        with zipfile.ZipFile(io.BytesIO(packed)) as archive:
            member = archive.infolist()[0]
            if member.compress_type not in _METHODS:
                raise InputRefused("unsupported ZIP compression method", expected="stored or deflated")
            with archive.open(member) as file:
                content = file.read(limit_bytes + 1)
    except InputRefused:
        raise
    except (
        zipfile.BadZipFile, zlib.error, struct.error, ValueError, IndexError, OSError, EOFError,
        RuntimeError,  # it wants a password, or a feature that is missing here
        OverflowError,  # a 64-bit offset
    ) as error:  # fmt: skip
        raise InputRefused(f"a ZIP file cannot be read: {error}") from error
    if len(content) > limit_bytes:
        raise InputRefused("a packed file expands beyond the limit", limit=f"{limit_bytes} bytes")
    return content


OUT_OF_MEMORY = errors.codes[errors.XML_ERROR_NO_MEMORY]
MOST_ELEMENTS = 100_000  # a camera's description has up to thirty thousand
DEEPEST_XML = 64
NAMES_BYTES = 20_000_000  # in total: a namespace name is repeated in that of every element


def parse_xml(data: bytes, limit_bytes: int) -> ElementTree.Element:
    """Parse XML and return the root element. Raises INP-001 if it is oversized or invalid."""
    if len(data) > limit_bytes:
        raise InputRefused("the XML is too large", limit=f"{limit_bytes} bytes", got=str(len(data)))
    parser = ElementTree.XMLParser(target=_Builder())
    try:
        parser.feed(data)
        root: ElementTree.Element = parser.close()
    except InputRefused:
        raise
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # the last two from an encoding
        if getattr(error, "code", None) == OUT_OF_MEMORY:
            raise MemoryError from error  # which says nothing about the XML
        raise InputRefused(f"not valid XML: {error}") from error
    return root


class _Builder(ElementTree.TreeBuilder):
    def __init__(self) -> None:
        super().__init__()
        self._elements = self._depth = self._names = 0

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        raise InputRefused("XML declares a document type", got=name[:DEEPEST_XML])

    def start(self, tag: str, attributes: dict[str, str]) -> ElementTree.Element:
        self._elements += 1
        self._depth += 1
        self._names += len(tag) + sum(len(name) for name in attributes)
        if self._elements > MOST_ELEMENTS or self._names > NAMES_BYTES:
            raise InputRefused("XML with too many elements", limit=f"{MOST_ELEMENTS} elements")
        if self._depth > DEEPEST_XML:
            raise InputRefused("XML nested too deep", limit=f"{DEEPEST_XML} levels")
        return super().start(tag, attributes)

    def end(self, tag: str) -> ElementTree.Element:
        self._depth -= 1
        return super().end(tag)
