"""RSI telegrams: the controller's `<Rob Type="KUKA">...` out, the client's `<Sen Type="...">...` in."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from math import isfinite
from typing import NamedTuple
from xml.etree import ElementTree

from ronna_hw.bounded_input import InputRefused, parse_xml
from ronna_hw.wire.kuka_context import FREE_TAG, INTERNAL, Feedback, ReceiveElement, SendElement
from sim.kuka.controller_parameters import ControllerParameters
from sim.kuka.errors import ETHERNET_FILE_INVALID

FRAME = ("X", "Y", "Z", "A", "B", "C")
AXIS = ("A1", "A2", "A3", "A4", "A5", "A6")
EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")
KEYWORD_PREFIX = "DEF_"
TECH_GENERATORS = 6
TECH_PARAMETERS = 10

# Keyword -> attributes, and their source: actual or set values, or zeros for what is not fitted.
ACTUAL_FRAME, ACTUAL_AXES, SET_FRAME, SET_AXES = "RIst", "AIPos", "RSol", "ASPos"
CURRENTS, NOTHING = "MACur", ""
FORCES = "FT"  # element of a force sensor, wired to inputs of the ETHERNET object
KEYWORDS = {
    "RIst": (FRAME, ACTUAL_FRAME),
    "RSol": (FRAME, SET_FRAME),
    "AIPos": (AXIS, ACTUAL_AXES),
    "ASPos": (AXIS, SET_AXES),
    "EIPos": (EXTERNAL, NOTHING),
    "ESPos": (EXTERNAL, NOTHING),
    "MACur": (AXIS, CURRENTS),
    "MECur": (EXTERNAL, NOTHING),
}
DELAY = "Delay"
LATE = 0  # position among the integers: late packets, Stat of AXISCORR, Stat of POSCORR
STATS = {"AXISCORR": 1, "POSCORR": 2}
NO_CURRENTS = NO_FORCES = (0.0,) * 6
ONLY_DELAY = [LATE]
ZERO_OF = {"BOOL": "0", "LONG": "0", "STRING": ""}

LONGEST_REPLY = 16384  # bytes; the longest configuration of 64 channels is far below

_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,3})?")
_PLAIN_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)")
_STAMP = re.compile(r"\d{1,20}")
_DIGIT_ATTRIBUTE = re.compile(rb"(\s)(\d[\w.-]*\s*=)")

AGAIN_S = 1.0  # shortest time between two reports

_TYPE = re.compile(rb"<Sen\b[^>]*\bType\s*=\s*[\"']([^\"'<>]{0,40})")
_IPOC = re.compile(rb"<IPOC>\s*(\d{1,20})\s*</IPOC>")


class TelegramWriter:
    """Writes one run's telegrams, byte for byte as a KR C4 sends them.

    Elements are in the order of the configuration, without white space, IPOC last. The layout is compiled
    once per run; while the arm is at rest its numbers are not even reformatted. `set_axes_deg` and
    `set_frame` are the programmed pose.
    """

    def __init__(
        self,
        elements: Sequence[SendElement],
        precision: int,
        set_axes_deg: Sequence[float],
        set_frame: Sequence[float],
        feedback: Sequence[Feedback] = (),
    ) -> None:
        self._number = f"%.{precision}f"
        self._order: list[str] = []
        self._counts: list[int] = []  # meaning of each integer in the telegram
        self._stats = {wire.indx: STATS[wire.object] for wire in feedback}
        constants = {SET_AXES: set_axes_deg, SET_FRAME: set_frame, NOTHING: (0.0,) * 6}
        groups: list[tuple[str, str]] = []  # name, attributes or text as a template
        for element in elements:
            self._add(groups, element, constants)
        body = "".join(
            f"<{name}{content}/>" if content.startswith(" ") else f"<{name}>{content}</{name}>"
            for name, content in groups
        )
        # Filled in two stages: positions and currents when they have changed, D and IPOC in every cycle.
        self._template = f'<Rob Type="KUKA">{body}<IPOC>%%d</IPOC></Rob>'
        self._last: tuple[Sequence[float] | None, ...] = (None, None, None, None)
        self._filled = ""

    @property
    def states_currents(self) -> bool:
        """Whether the telegram has the motor currents."""
        return CURRENTS in self._order

    @property
    def states_forces(self) -> bool:
        """Whether the telegram has the signals of a force sensor."""
        return FORCES in self._order

    def write(
        self,
        frame: Sequence[float],
        axes_deg: Sequence[float],
        late: int,
        ipoc: int,
        stats: tuple[int, int] = (0, 0),
        currents: Sequence[float] = NO_CURRENTS,
        forces: Sequence[float] = NO_FORCES,
    ) -> bytes:
        """Encode a telegram: actual frame (mm, deg), actual axes (deg), late packet count and IPOC.

        `stats` are the Stat outputs of AXISCORR and POSCORR, `currents` those of the motors (%), `forces`
        those of a sensor (N, Nm).
        """
        last = self._last
        changed = last[0] is not axes_deg or last[1] is not frame or last[2] is not currents
        if changed or last[3] is not forces:
            numbers = {ACTUAL_FRAME: frame, ACTUAL_AXES: axes_deg, CURRENTS: currents, FORCES: forces}
            values: list[float] = []
            for name in self._order:
                values += numbers[name]
            self._filled = self._template % tuple(values)
            self._last = (axes_deg, frame, currents, forces)
        if self._counts == ONLY_DELAY:
            return (self._filled % (late, ipoc)).encode("ascii")
        counts = (late, *stats)
        return (self._filled % (*(counts[position] for position in self._counts), ipoc)).encode("ascii")

    def _add(
        self,
        groups: list[tuple[str, str]],
        element: SendElement,
        constants: dict[str, Sequence[float]],
    ) -> None:
        tag = element.tag
        if tag == FREE_TAG:
            return
        if element.indx != INTERNAL:
            name, _, attribute = tag.partition(".")
            if name == FORCES:
                if FORCES not in self._order:
                    self._order.append(FORCES)
                self._append(groups, name, f' {attribute}="{self._number}"')
                return
            zero = ZERO_OF.get(element.type, self._number % 0.0)
            if element.indx in self._stats:
                self._counts.append(self._stats[element.indx])
                zero = "%%d" if element.type in ZERO_OF else f"%{self._number}"
            if not attribute:
                groups.append((name, zero))
                return
            self._append(groups, name, f' {attribute}="{zero}"')
            return
        name, _, part = tag.removeprefix(KEYWORD_PREFIX).partition(".")
        if name == DELAY:
            self._counts.append(LATE)
            groups.append((name, ' D="%%d"'))
        elif name == "Tech" and part[:1] == "C" and part[1:] in map(str, range(1, TECH_GENERATORS + 1)):
            text = "".join(
                f' {part}{parameter}="{self._number % 0.0}"' for parameter in range(1, TECH_PARAMETERS + 1)
            )
            self._append(groups, name, text)
        elif name in KEYWORDS and not part:
            attributes, source = KEYWORDS[name]
            if source in constants:
                values = [self._number % value for value in constants[source]]
            else:
                self._order.append(source)
                values = [self._number] * 6
            groups.append(
                (name, "".join(f' {a}="{value}"' for a, value in zip(attributes, values, strict=True)))
            )
        else:
            raise ETHERNET_FILE_INVALID(f"SEND: {tag} is not an RSI keyword")

    @staticmethod
    def _append(groups: list[tuple[str, str]], name: str, text: str) -> None:
        if groups and groups[-1][0] == name and groups[-1][1].startswith(" "):
            groups[-1] = (name, groups[-1][1] + text)
        else:
            groups.append((name, text))


class Reply(NamedTuple):
    """A parsed reply: its IPOC and one number per receive element, or None if absent."""

    ipoc: int
    values: Sequence[float | None]
    message: str = ""  # EStr, shown on the pendant


class ReplyReader:
    """Parses replies for one configuration, lenient about form but strict about content.

    Any order, unknown or missing elements, blanks and line ends are accepted. A wrong root or Type, no IPOC,
    an invalid number, malformed XML or a document type make it no reply at all. STRING channels count as 0.
    """

    def __init__(
        self, elements: Sequence[ReceiveElement], sentype: str, parameters: ControllerParameters | None = None
    ) -> None:
        parameters = parameters or ControllerParameters()
        self._number = _NUMBER if parameters.reads_exponents else _PLAIN_NUMBER
        self._rejects_bad_numbers = parameters.bad_number == "no_reply"
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
        self._match = re.compile(self._compile_pattern(elements).encode()).fullmatch
        # The groups of the expression are then the elements; messages and generators have no group.
        self._dense = list(self._places.values()) == list(range(self._count))

    def read(self, data: bytes) -> Reply | None:
        """Parse a datagram, or return None if it is not a reply."""
        found = self._match(data)
        if found is None:
            return self._read_strictly(data)
        *texts, ipoc = found.groups()
        numbers = list(map(float, texts))
        if self._dense:
            return Reply(int(ipoc), numbers)
        values: list[float | None] = [None] * self._count
        for place, number in zip(self._places.values(), numbers, strict=True):
            values[place] = number
        return Reply(int(ipoc), values)

    def _compile_pattern(self, elements: Sequence[ReceiveElement]) -> str:
        # Only the usual form: configured order, plain decimals. Everything else uses the parser.
        # Possessive: what cannot match otherwise is not remembered.
        number = r"([-+]?\d{1,15}+(?:\.\d{0,15}+)?+)"
        parts = [rf'\s*+<Sen Type="{re.escape(self._sentype)}">\s*+']
        group = ""
        for element in elements:
            if element.tag == FREE_TAG:
                continue
            if element.indx == INTERNAL or element.type == "STRING":
                return r"(?!)"  # text is read by the parser only
            name, _, attribute = element.tag.partition(".")
            if group and (name != group or not attribute):
                parts.append(r"\s*+/>\s*+")
                group = ""
            if not attribute:
                parts.append(rf"<{name}>{number}</{name}>\s*+")
                continue
            if not group:
                parts.append(rf"<{name}")
                group = name
            parts.append(rf'\s++{re.escape(attribute)}="{number}"')
        if group:
            parts.append(r"\s*+/>\s*+")
        parts.append(r"<IPOC>\s*+(\d{1,20}+)\s*+</IPOC>\s*+</Sen>\s*+\0*+")
        return "".join(parts)

    def _read_strictly(self, data: bytes) -> Reply | None:
        end = data.rfind(b"</Sen>")
        if end < 0 or len(data) > LONGEST_REPLY:
            return None
        content = data[: end + len(b"</Sen>")]
        if self._digits_in_names:  # a manufacturer's own client sends GPIO 01="1", which is not XML
            content = _DIGIT_ATTRIBUTE.sub(rb"\1_\2", content)
        try:
            return self._parse_root(parse_xml(content, len(content)))
        except InputRefused:
            return None

    def _parse_root(self, root: ElementTree.Element) -> Reply | None:
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
            number = self._parse_number(text.strip())
            if number is None and self._rejects_bad_numbers:
                return None
            values[place] = number
        return Reply(int(stamp), values, found.get(("EStr", ""), ""))

    def _parse_number(self, text: str) -> float | None:
        if not self._number.fullmatch(text):
            return None
        number = float(text)
        return number if isfinite(number) else None


class RejectedReplies:
    """Counts rejected replies and reports the last reason at most once per `AGAIN_S`.

    A real controller reports nothing.
    """

    def __init__(self, sentype: str) -> None:
        self.count = 0
        self._sentype = sentype
        self._reported = 0
        self._reported_s = float("-inf")
        self._last: tuple[bytes, int] = (b"", 0)

    def record(self, data: bytes, ipoc: int) -> None:
        """Count a reply rejected in the cycle with this IPOC; cheap enough to call every cycle."""
        self.count += 1
        self._last = (data, ipoc)

    def report(self, now_s: float, say: Callable[[str, int], None]) -> None:
        """Call `say` with the reason for the last rejection and the count, if due and not yet reported."""
        if self.count == self._reported or now_s < self._reported_s + AGAIN_S:
            return
        self._reported, self._reported_s = self.count, now_s
        say(f"reply rejected: {self._describe_reason()}", self.count)

    def _describe_reason(self) -> str:
        data, expected = self._last
        found = _TYPE.search(data)
        if found is None:
            return "no <Sen Type=...>"
        if found[1] != self._sentype.encode():
            return f"Type {found[1].decode('ascii', 'replace')}, expected {self._sentype}"
        stamp = _IPOC.search(data)
        if stamp is None:
            return "no IPOC"
        if int(stamp[1]) != expected:
            return f"IPOC {int(stamp[1])}, expected {expected}, that of the telegram it answers"
        return "not well-formed XML, or a value that is not a number"
