"""External input, checked against bounds before use: size, depth, count, expansion.

A file, a reply or a datagram may be damaged, or malicious; a few bytes must not cost gigabytes or minutes.
Everything here raises INP-001, which is also a ValueError, so that the reader of a specific format can
refuse with its own code.
"""

from __future__ import annotations

from ronna_hw.bounded_input.files import read_bounded
from ronna_hw.bounded_input.json_text import (
    MOST_VALUES,
    check_json,
    parse_json,
    read_json_bytes,
    read_json_lines,
    values_in,
)
from ronna_hw.bounded_input.refusal import InputRefused
from ronna_hw.bounded_input.toml_text import LARGEST_TOML_BYTES, parse_toml, read_toml, toml_of
from ronna_hw.bounded_input.unpacking import inflate, unzip
from ronna_hw.bounded_input.xml_tree import parse_xml

__all__ = [
    "LARGEST_TOML_BYTES",
    "MOST_VALUES",
    "InputRefused",
    "check_json",
    "inflate",
    "parse_json",
    "parse_toml",
    "parse_xml",
    "read_bounded",
    "read_json_bytes",
    "read_json_lines",
    "read_toml",
    "toml_of",
    "unzip",
    "values_in",
]
