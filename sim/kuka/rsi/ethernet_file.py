"""KUKA's RSI Ethernet file: telegram layout and client address.

The wiring of the channels is not in the file but in the RSI context; without one it is inferred from
the commonly used tags.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from pydantic import ValidationError

from ronna_hw.bounded_input import InputRefused, parse_xml, read_bounded
from ronna_hw.mistakes import describe_mistakes
from ronna_hw.text import format_count
from ronna_hw.wire.kuka_context import RsiContext
from sim.kuka.errors import ETHERNET_FILE_INVALID
from sim.kuka.rsi.telegrams import AXIS, FRAME

SECTIONS = ("SEND", "RECEIVE")
INTERNAL = "INTERNAL"
LARGEST_FILE_BYTES = 1_000_000  # one line per element, of which there are up to 128
AXIS_GROUPS = ("AK", "AKorr")
FRAME_GROUPS = ("RKorr",)
STOP_TAGS = ("Stop", "MoveStop")
STAT_TAGS = {"AKorr.Stat": "AXISCORR", "AK.Stat": "AXISCORR", "RKorr.Stat": "POSCORR"}
# for a link without a context: the value in all public projects
INFERRED_TIMEOUT_PACKETS = 100
INFERRED_PRECISION = 4

_TAG = re.compile(r"[A-Za-z_][A-Za-z0-9_-]*(\.[A-Za-z0-9_-]+)?")


def read_ethernet_file(path: Path, context: RsiContext | None, longest_name: int) -> RsiContext:
    """Return the effective context: layout from the file, the rest from `context` or inferred from tags.

    Raises KRC-001 with every mistake, and for a name of more than `longest_name` characters.
    """
    if len(path.stem) > longest_name:
        raise ETHERNET_FILE_INVALID(
            f"the name {path.name} is too long", limit=f"{longest_name} characters", got=f"{len(path.stem)}"
        )
    root = _read_root(path)
    config = {
        name: (root.findtext(f"CONFIG/{name}") or "").strip()
        for name in ("IP_NUMBER", "PORT", "SENTYPE", "ONLYSEND")
    }
    protocol = (root.findtext("CONFIG/PROTOCOL") or "UDP").strip().upper()
    if protocol != "UDP":
        raise ETHERNET_FILE_INVALID(f"{path.name}: PROTOCOL {protocol} is not supported", expected="UDP")
    elements = {
        section: [
            _parse_element(element, path, section) for element in root.findall(f"{section}/ELEMENTS/ELEMENT")
        ]
        for section in SECTIONS
    }
    content: dict[str, Any] = (
        {
            "schema": 1,
            "name": "foreign",
            "program": {"cycle_ms": 4, "corrections": "absolute", "variant": "kr6_r900_sixx"},
            "wiring": _infer_wiring(elements["RECEIVE"]),
            "feedback": _infer_feedback(elements["SEND"]),
        }
        if context is None
        else {**context.model_dump(by_alias=True)}
    )
    if context is None and any(wire["object"] == "STOP" for wire in content["wiring"]):
        content["stop"] = {}
    parameters = (
        {"timeout_packets": INFERRED_TIMEOUT_PACKETS, "precision": INFERRED_PRECISION}
        if context is None
        else {**content["ethernet"]}
    )
    content["ethernet"] = {
        **parameters,
        "pc_ip": config["IP_NUMBER"],
        "pc_port": _parse_integer(config["PORT"], path, "PORT"),
        "sentype": config["SENTYPE"],
        "only_send": (config["ONLYSEND"] or "FALSE").upper() == "TRUE",
    }
    sent = elements["SEND"]
    for element in sent:
        element.pop("holdon", None)
    required, optional = len(sent), content.get("optional_send", ())
    while required and sent[required - 1] in optional:
        required -= 1
    content["send"], content["optional_send"] = tuple(sent[:required]), tuple(sent[required:])
    content["receive"] = tuple(elements["RECEIVE"])
    try:
        return RsiContext.model_validate(content)
    except ValidationError as error:
        mistakes = describe_mistakes(error)
        raise ETHERNET_FILE_INVALID(
            f"{path.name} has {format_count(len(mistakes), 'mistake')}: " + "; ".join(mistakes)
        ) from None


def _read_root(path: Path) -> ElementTree.Element:
    try:
        root = parse_xml(read_bounded(path, LARGEST_FILE_BYTES), LARGEST_FILE_BYTES)
    except OSError as error:
        raise ETHERNET_FILE_INVALID(
            f"cannot read {path.name}: {error.strerror}", action="Give the path of an RSI Ethernet file."
        ) from error
    except InputRefused as error:
        raise ETHERNET_FILE_INVALID(f"{path.name} is not XML: {error.summary}") from error
    if root.tag != "ROOT" or root.find("CONFIG") is None:
        raise ETHERNET_FILE_INVALID(f"{path.name} is not an Ethernet file", expected="ROOT > CONFIG")
    return root


def _parse_element(element: ElementTree.Element, path: Path, section: str) -> dict[str, Any]:
    tag = element.get("TAG", "")
    if not _TAG.fullmatch(tag):
        raise ETHERNET_FILE_INVALID(f"{path.name}: {section} has an element with TAG {tag!r}")
    indx = element.get("INDX", "")
    return {
        "tag": tag,
        "type": element.get("TYPE", "").upper(),
        "indx": INTERNAL if indx.upper() == INTERNAL else _parse_integer(indx, path, f"INDX of {tag}"),
        "holdon": _parse_integer(element.get("HOLDON", "0"), path, f"HOLDON of {tag}"),
    }


def _parse_integer(text: str, path: Path, what: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise ETHERNET_FILE_INVALID(f"{path.name}: {what} is {text!r}", expected="an integer") from None


def _infer_wiring(receive: list[dict[str, Any]]) -> tuple[dict[str, Any], ...]:
    wires: dict[tuple[str, str], dict[str, Any]] = {}
    for element in receive:
        group, _, attribute = element["tag"].partition(".")
        if group in AXIS_GROUPS and attribute in AXIS:
            place = ("AXISCORR", attribute)
        elif group in FRAME_GROUPS and attribute in FRAME:
            place = ("POSCORR", attribute)
        elif element["tag"] in STOP_TAGS:
            place = ("STOP", "In1")
        else:
            continue
        if element["indx"] != INTERNAL and place not in wires:
            wires[place] = {"indx": element["indx"], "object": place[0], "input": place[1]}
    return tuple(wires.values())


def _infer_feedback(send: list[dict[str, Any]]) -> tuple[dict[str, Any], ...]:
    return tuple(
        {"indx": element["indx"], "object": STAT_TAGS[element["tag"]]}
        for element in send
        if element["tag"] in STAT_TAGS and element["indx"] != INTERNAL
    )
