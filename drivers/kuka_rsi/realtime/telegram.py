"""RSI telegrams: parsing of telegrams and encoding of replies.

The reader is a regular expression compiled from the agreed elements. Other telegrams go through a strict XML
parser, and are rejected if that fails. The reply is written in two parts: everything up to the IPOC can be
prepared before the telegram arrives.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from math import isfinite
from operator import itemgetter
from typing import NamedTuple
from xml.parsers import expat

from drivers.kuka_rsi.errors import BAD_TELEGRAM
from drivers.kuka_rsi.realtime.settings import AXIS_NAMES
from ronna_hw.vectors import JointVector, Vector3, joint_vector

FREE_TAG = "FREE"  # reserves a channel and is not on the wire
KEYWORD_PREFIX = "DEF_"
CARTESIAN = ("X", "Y", "Z", "A", "B", "C")
EXTERNAL = ("E1", "E2", "E3", "E4", "E5", "E6")
KEYWORD_ATTRIBUTES: dict[str, tuple[str, ...]] = {
    "RIst": CARTESIAN,
    "RSol": CARTESIAN,
    "AIPos": AXIS_NAMES,
    "ASPos": AXIS_NAMES,
    "EIPos": EXTERNAL,
    "ESPos": EXTERNAL,
    "MACur": AXIS_NAMES,
    "MECur": EXTERNAL,
    "Delay": ("D",),
}
GENERATOR_PARAMETERS = 10  # C1 of a Tech element is C11 .. C110
REPLY_TAIL = b"</IPOC></Sen>"
ZERO, NEGATIVE_ZERO = b"0.000000", b"-0.000000"  # forms that a rounded correction must not have
ROOT, ROOT_TYPE = "Rob", "KUKA"
LONGEST_TELEGRAM = 8192  # one datagram; typical ones are below 1000 bytes
MOST_DIGITS = 19  # of an IPOC: it is published as a 64-bit unsigned number
MOST_LATE = 10**15  # of the controller's count; anything beyond is corrupt

# Possessive: no digit is given back, so that nothing is remembered for it.
_DECIMAL = rb"[-+]?\d{1,15}+(?:\.\d{0,15}+)?+"  # what float() is certain to parse
_INTEGER = rb"\d{1,15}+"
_UNREAD = rb" [^<>/]*+"  # attributes that are not examined before the reply is out
CURRENTS = "MACur"
FORCES = "FT"  # of a force sensor on the flange, along its axes
FORCE_NAMES = ("Fx", "Fy", "Fz", "Tx", "Ty", "Tz")
# Not every controller sends these; both have six values.
SOMETIMES_SENT = {CURRENTS: AXIS_NAMES, FORCES: FORCE_NAMES}
_SOMETIMES = {
    name: rb"(?:<%b(?P<%b>%b)/>)?+" % (name.encode(), name.encode(), _UNREAD) for name in SOMETIMES_SENT
}


def _compile_six(names: tuple[str, ...]) -> Callable[[bytes], re.Match[bytes] | None]:
    each = (b'%b="(%b)"' % (name.encode(), _DECIMAL) for name in names)
    return re.compile(rb"\s*+%b\s*+" % rb"\s++".join(each)).fullmatch


_READ_CURRENTS, _READ_FORCES = _compile_six(AXIS_NAMES), _compile_six(FORCE_NAMES)

Found = re.Match[bytes]


class Telegram(NamedTuple):
    """Decoded telegram; `ipoc` stays text because replies echo it unchanged."""

    axes_deg: JointVector
    delay: int  # the controller's own count of late packets, -1 if it does not send it
    ipoc: bytes
    currents: bytes = b""  # attributes of MACur as text, for `read_currents`; empty if it is not sent
    forces: bytes = b""  # attributes of FT as text, for `read_forces`; empty if it is not sent


class Element(NamedTuple):
    """XML element with its attributes, or with text if it has none."""

    name: str
    attributes: tuple[str, ...]


def group_elements(tags: tuple[str, ...]) -> tuple[Element, ...]:
    """Group declared tags into XML elements; consecutive tags with the same name share one."""
    result: list[Element] = []
    for tag in tags:
        if tag == FREE_TAG:
            continue
        keyword = tag.startswith(KEYWORD_PREFIX)
        name, _, attribute = tag.removeprefix(KEYWORD_PREFIX).partition(".")
        if keyword and not attribute:
            result.append(Element(name, KEYWORD_ATTRIBUTES.get(name, ())))
            continue
        attributes: tuple[str, ...] = (attribute,) if attribute else ()
        if keyword:  # Tech.C1
            attributes = tuple(f"{attribute}{n}" for n in range(1, GENERATOR_PARAMETERS + 1))
        if attributes and result and result[-1].name == name:
            result[-1] = Element(name, result[-1].attributes + attributes)
        else:
            result.append(Element(name, attributes))
    return tuple(result)


class TelegramReader:
    """Telegram parser for one RSI context."""

    def __init__(self, send_tags: tuple[str, ...]) -> None:
        pattern = [rb'<Rob Type="KUKA">']
        for name, attributes in group_elements(send_tags):
            if name in _SOMETIMES:
                pattern.append(_SOMETIMES[name])
                continue
            pattern.append(b"<" + re.escape(name.encode()))
            if not attributes:
                pattern.append(rb">[^<]{0,80}+</" + re.escape(name.encode()) + b">")
                continue
            if (captured := {"AIPos": _DECIMAL, "Delay": _INTEGER}.get(name)) is None:
                pattern.append(_UNREAD + b"/>")
                continue
            for attribute in attributes:
                tag = attribute.encode()
                pattern.append(b' %b="(?P<%b>%b)"' % (tag, tag, captured))
            pattern.append(b"/>")
        # A context without Delay, MACur or FT has their groups nevertheless.
        pattern.append(b"" if "DEF_Delay" in send_tags else b"(?P<D>)")
        pattern += [one for one in _SOMETIMES.values() if one not in pattern]
        pattern.append(b"<IPOC>(?P<IPOC>\\d{1,%d}+)</IPOC></Rob>" % MOST_DIGITS)
        if "DEF_AIPos" not in send_tags:
            pattern = [rb"(?!)"]  # nothing matches
        # Matches a telegram in the usual layout; returns None if it needs the strict parser.
        self.match: Callable[[bytes], Found | None] = re.compile(b"".join(pattern)).match

    def read(self, data: bytes) -> Telegram:
        """Decode a telegram in any layout; raises RSI-014 if it is invalid."""
        found = self.match(data)
        return read_strictly(data) if found is None else extract_telegram(found)


def extract_telegram(found: Found) -> Telegram:
    """Decode a telegram matched in the usual layout."""
    a, b, c, d, e, f, delay, ipoc, currents, forces = found.group(*AXIS_NAMES, "D", "IPOC", CURRENTS, FORCES)
    axes_deg = (float(a), float(b), float(c), float(d), float(e), float(f))
    return Telegram(axes_deg, int(delay) if delay else -1, ipoc, currents or b"", forces or b"")


def read_currents(attributes: bytes) -> JointVector | None:
    """Return the motor currents in percent from the attributes of MACur, None unless all are there."""
    found = _READ_CURRENTS(attributes)
    return None if found is None else joint_vector(map(float, found.groups()))


def read_forces(attributes: bytes) -> Vector3 | None:
    """Return the force (N) along the sensor's axes from the attributes of FT, None unless all are there."""
    if (found := _READ_FORCES(attributes)) is None:
        return None
    x, y, z, *_ = map(float, found.groups())
    return x, y, z


def read_strictly(data: bytes) -> Telegram:
    """Decode a telegram with an XML parser; raises RSI-014, also for a DTD."""
    values: dict[tuple[str, str], str] = {}
    path: list[str] = []
    text: list[str] = []

    def start(name: str, attributes: dict[str, str]) -> None:
        if not path:
            kind = attributes.get("Type", attributes.get("TYPE"))
            if name != ROOT or kind != ROOT_TYPE:
                raise BAD_TELEGRAM(
                    "wrong root element or Type",
                    expected=f'<{ROOT} Type="{ROOT_TYPE}">',
                    got=f'<{name} Type="{kind}">',
                    wire=data,
                )
        if path[1:2] == ["IPOC"]:
            raise BAD_TELEGRAM("an element within the IPOC", got=f"<{name}>", wire=data)
        path.append(name)
        text.clear()
        if len(path) == 2:
            for key, value in attributes.items():
                values[name, key] = value

    def end(name: str) -> None:
        if len(path) == 2:
            values[name, ""] = "".join(text).strip()
        path.pop()

    def refuse(*_: object) -> None:
        raise BAD_TELEGRAM("a document type in a telegram", wire=data)

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.CharacterDataHandler = text.append
    parser.StartDoctypeDeclHandler = refuse
    if (end_of_root := data.rfind(b"</Rob>")) < 0 or len(data) > LONGEST_TELEGRAM:
        raise BAD_TELEGRAM("incomplete telegram", expected="<Rob>...</Rob>", wire=data)
    try:
        parser.Parse(data[: end_of_root + len(b"</Rob>")], True)  # bytes after the root are tolerated
        axes_deg = tuple(float(values["AIPos", axis]) for axis in AXIS_NAMES)
        if not all(map(isfinite, axes_deg)):
            raise BAD_TELEGRAM("an axis value is not finite", wire=data)
        delay = int(float(values["Delay", "D"])) if ("Delay", "D") in values else -1
        ipoc = values["IPOC", ""]
        if not -1 <= delay < MOST_LATE:
            raise BAD_TELEGRAM("the count of late packets is impossible", got=str(delay)[:32], wire=data)
        if not (ipoc.isascii() and ipoc.isdigit() and len(ipoc) <= MOST_DIGITS):
            raise BAD_TELEGRAM("the IPOC is not an integer", got=ipoc[:32], wire=data)
    except (expat.ExpatError, LookupError, ValueError, OverflowError) as error:  # an encoding: LookupError
        raise BAD_TELEGRAM(f"malformed telegram: {error}", wire=data) from error
    currents, forces = (
        "".join(f' {key}="{values[name, key]}"' for key in keys if (name, key) in values).encode()
        for name, keys in SOMETIMES_SENT.items()
    )
    return Telegram(axes_deg, delay, ipoc.encode(), currents, forces)


class ReplyWriter:
    """Reply encoder for one RSI context: `head(...)`, then the IPOC, then `REPLY_TAIL`."""

    def __init__(
        self, sentype: str, receive_tags: tuple[str, ...], axis_tags: tuple[str, ...], stop_tag: str
    ) -> None:
        placeholders = {tag: f"%({axis})s" for tag, axis in zip(axis_tags, AXIS_NAMES, strict=True)}
        placeholders[stop_tag] = "%(Stop)s"
        parts = [f'<Sen Type="{sentype}">']
        for name, attributes in group_elements(receive_tags):
            if attributes:
                inner = " ".join(f'{a}="{placeholders.get(f"{name}.{a}", "0")}"' for a in attributes)
                parts.append(f"<{name} {inner}/>")
            else:
                parts.append(f"<{name}>{placeholders.get(name, '0')}</{name}>")
        parts.append("<IPOC>")
        template = "".join(parts)
        order = re.findall(r"%\((\w+)\)s", template)
        self._pick_in_order = itemgetter(*((*AXIS_NAMES, "Stop").index(name) for name in order))
        for name in AXIS_NAMES:
            template = template.replace(f"%({name})s", "%.6f")
        self._template = template.replace("%(Stop)s", "%d").encode("ascii")

    def head(self, corrections_deg: JointVector, stop: bool = False) -> bytes:
        """Encode a reply up to its IPOC; corrections in deg with six decimals."""
        head: bytes = self._template % self._pick_in_order((*corrections_deg, stop))
        return head.replace(NEGATIVE_ZERO, ZERO) if NEGATIVE_ZERO in head else head
