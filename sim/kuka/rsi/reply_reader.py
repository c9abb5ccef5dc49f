"""Reads the client's reply, `<Sen Type="...">...`, leniently in form and strictly in content.

Any order, unknown or missing elements, blanks and line ends are accepted. A wrong root or Type, no IPOC, an
invalid number, malformed XML or a document type make it no reply at all.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import isfinite
from typing import NamedTuple
from xml.etree import ElementTree

from ronna_hw.bounded_input import InputRefused, parse_xml
from ronna_hw.wire.kuka_context import FREE_TAG, INTERNAL, ReceiveElement
from sim.kuka.controller_parameters import ControllerParameters

LONGEST_REPLY = 16384  # bytes; the longest configuration of 64 channels is far below

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?")
_PLAIN_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)")
_STAMP = re.compile(r"\d{1,20}")
_DIGIT_ATTRIBUTE = re.compile(rb"(\s)(\d[\w.-]*\s*=)")


class Reply(NamedTuple):
    """A reply: its time stamp, and per receive element a number, or None if absent."""

    ipoc: int
    values: Sequence[float | None]
    message: str = ""  # EStr, shown on the pendant


class ReplyReader:
    """Reads replies of one configuration. Text channels (STRING) have no meaning here and count as 0."""

    def __init__(
        self, elements: Sequence[ReceiveElement], sentype: str, parameters: ControllerParameters | None = None
    ) -> None:
        parameters = parameters or ControllerParameters()
        self._number = _NUMBER if parameters.reads_exponents else _PLAIN_NUMBER
        self._spoils = parameters.bad_number == "no_reply"
        self._sentype = sentype
        self._count = len(elements)
        self._places: dict[tuple[str, str], int] = {}
        self._digits_in_names = False
        for number, element in enumerate(elements):
            if element.indx == INTERNAL or element.tag == FREE_TAG or element.type == "STRING":
                continue
            name, _, attribute = element.tag.partition(".")
            self._places[name, attribute] = number
            self._digits_in_names |= attribute[:1].isdigit()
        self._match = re.compile(self._pattern(elements).encode()).fullmatch
        # The expression's groups follow the elements; others (messages, generators) have none.
        self._dense = list(self._places.values()) == list(range(self._count))

    def read(self, data: bytes) -> Reply | None:
        """The reply, or None when it is not one."""
        found = self._match(data)
        if found is None:
            return self._read_strictly(data)
        *texts, ipoc = found.groups()
        numbers = [float(text) for text in texts]
        if self._dense:
            return Reply(int(ipoc), numbers)
        values: list[float | None] = [None] * self._count
        for place, number in zip(self._places.values(), numbers, strict=True):
            values[place] = number
        return Reply(int(ipoc), values)

    def _pattern(self, elements: Sequence[ReceiveElement]) -> str:
        # Only the usual form: configured order, plain decimals. Everything else uses the parser.
        number = r"([-+]?\d{1,15}(?:\.\d{0,15})?)"
        parts = [rf'\s*<Sen Type="{re.escape(self._sentype)}">\s*']
        group = ""
        for element in elements:
            if element.tag == FREE_TAG:
                continue
            if element.indx == INTERNAL or element.type == "STRING":
                return r"(?!)"  # text is read by the parser only
            name, _, attribute = element.tag.partition(".")
            if group and (name != group or not attribute):
                parts.append(r"\s*/>\s*")
                group = ""
            if not attribute:
                parts.append(rf"<{name}>{number}</{name}>\s*")
                continue
            if not group:
                parts.append(rf"<{name}")
                group = name
            parts.append(rf'\s+{re.escape(attribute)}="{number}"')
        if group:
            parts.append(r"\s*/>\s*")
        parts.append(r"<IPOC>\s*(\d{1,20})\s*</IPOC>\s*</Sen>\s*\0*")
        return "".join(parts)

    def _read_strictly(self, data: bytes) -> Reply | None:
        end = data.rfind(b"</Sen>")
        if end < 0 or len(data) > LONGEST_REPLY:
            return None
        content = data[: end + len(b"</Sen>")]
        if self._digits_in_names:  # a manufacturer's own client sends GPIO 01="1", which is not XML
            content = _DIGIT_ATTRIBUTE.sub(rb"\1_\2", content)
        try:
            return self._reply_of(parse_xml(content, len(content)))
        except InputRefused:
            return None

    def _reply_of(self, root: ElementTree.Element) -> Reply | None:
        if root.tag != "Sen" or root.get("Type") != self._sentype:
            return None
        found: dict[tuple[str, str], str] = {}
        for element in root:
            found |= {(element.tag, name): text for name, text in element.items()}
            if element.text and element.text.strip():
                found[element.tag, ""] = element.text
        stamp = found.get(("IPOC", ""), "").strip()
        if not _STAMP.fullmatch(stamp):
            return None
        values: list[float | None] = [None] * self._count
        for (name, attribute), place in self._places.items():
            key = (name, f"_{attribute}" if attribute[:1].isdigit() else attribute)
            text = found.get(key)
            if text is None:
                continue
            number = self._number_in(text.strip())
            if number is None and self._spoils:
                return None
            values[place] = number
        return Reply(int(stamp), values, found.get(("EStr", ""), ""))

    def _number_in(self, text: str) -> float | None:
        if not self._number.fullmatch(text):
            return None
        number = float(text)
        return number if isfinite(number) else None
