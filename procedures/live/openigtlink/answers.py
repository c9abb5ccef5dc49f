"""Answers to clients. They may ask for any value; whatever else they send is refused and moves nothing."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from procedures.live.openigtlink.names import SERVER
from procedures.live.openigtlink.outgoing import Outgoing
from ronna_hw.wire.openigtlink import Malformed, Message
from ronna_hw.wire.openigtlink_contents import (
    TRANSFORM_QUERIES,
    Command,
    Status,
    StatusCode,
    decode_command,
    encode_capability,
    encode_command,
    encode_status,
    encode_string,
)

REFUSAL: Final = "This server only shows a running case: nothing that it receives moves or changes anything."
DENIED: Final = "AccessDenied"
SENT: Final = ("TRANSFORM", "TDATA", "QTDATA", "STATUS", "STRING", "POINT", "TRAJ", "IMAGE", "CAPABILITY")
QUERIES: Final = {
    **dict.fromkeys(TRANSFORM_QUERIES, "TRANSFORM"),
    "GET_STATUS": "STATUS",
    "GET_STRING": "STRING",
    "GET_POINT": "POINT",
    "GET_TRAJ": "TRAJ",
}
SUBSCRIPTIONS: Final = {f"{verb}_{kind}": kind for kind in ("TDATA", "QTDATA") for verb in ("STT", "STP")}
ASKED: Final = (*QUERIES, "GET_CAPABIL", "GET_IMAGE", *SUBSCRIPTIONS)
TAKEN_SILENTLY: Final = ("STATUS", "CAPABILITY", "CLIENTINFO")  # the last is PLUS's first message
DATA: Final = ("POSITION", "QTRANS", "NDARRAY", "POLYDATA", "SENSOR", "BIND", "IMGMETA", "LBMETA", "COLORT")
QUESTION_PREFIXES: Final = ("GET_", "STT_", "STP_")
OLD_COMMAND, OLD_ANSWER = "CMD_", "ACK_"  # names of a STRING that commands, and of its answer
Latest = Mapping[tuple[str, str], Outgoing]


def answer(message: Message, latest: Latest, version: int) -> list[Outgoing]:
    """Answer a message from the latest values; an unknown type is skipped."""
    kind, name = message.kind, message.name
    if message.fault:
        return [status(StatusCode.CHECKSUM_ERROR, message.fault, "NotIntact")]
    if kind in QUERIES:
        return _find(QUERIES[kind], name, latest, version)
    if kind == "GET_CAPABIL":
        return [Outgoing("CAPABILITY", SERVER, encode_capability((*SENT, *ASKED)))]
    if kind == "COMMAND":
        return [_refuse_command(message)]
    if kind == "STRING" and name.startswith(OLD_COMMAND):
        number = name.removeprefix(OLD_COMMAND)
        return [Outgoing("STRING", OLD_ANSWER + _plain(number), encode_string(f"{DENIED}: {REFUSAL}"))]
    if kind.startswith(QUESTION_PREFIXES):
        text = f"{_plain(kind)} is not answered here; {', '.join(ASKED)} are."
        return [status(StatusCode.UNKNOWN_INSTRUCTION, text, "UnknownType")]
    if kind not in TAKEN_SILENTLY and kind in (*SENT, *DATA):
        return [status(StatusCode.ACCESS_DENIED, f"{kind}: {REFUSAL}", DENIED)]
    return []


def status(code: StatusCode, text: str, error: str = "") -> Outgoing:
    """Return a STATUS of the server itself."""
    return Outgoing("STATUS", SERVER, encode_status(Status(code, text, error)))


def nothing(kind: str, name: str) -> Outgoing:
    """Return the answer to a question for what there is not: a message without content."""
    return Outgoing(kind, _plain(name), b"")


def _find(kind: str, name: str, latest: Latest, version: int) -> list[Outgoing]:
    """Return the value of this name, without a name all of the type."""
    found = [
        one
        for one in latest.values()
        if one.kind == kind and name in ("", one.name) and not (one.needs_metadata and version == 1)
    ]
    return found or [nothing(kind, name)]


def _refuse_command(message: Message) -> Outgoing:
    try:
        number = decode_command(message.content).number
    except Malformed as error:
        return status(StatusCode.CHECKSUM_ERROR, str(error), "NotIntact")
    return Outgoing("RTS_COMMAND", _plain(message.name), encode_command(Command(number, DENIED, REFUSAL)))


def _plain(text: str) -> str:
    """Return a name that was received in letters which can be sent."""
    return text.encode("ascii", "replace").decode()
