"""Bring an initialised unit to a known set-up: line rate, volume, illuminators, tools."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cached_property

from drivers.ndi_polaris.codec import warning_meaning
from drivers.ndi_polaris.discovery import answers, find_unit, initialise
from drivers.ndi_polaris.errors import (
    BadReplyCrc,
    HandleRefused,
    LinkLost,
    MalformedReply,
    NoReply,
    PortUnavailable,
    UnitError,
)
from drivers.ndi_polaris.options import ToolOption
from drivers.ndi_polaris.parameters import read_parameter
from drivers.ndi_polaris.rom import ToolDefinition, encode_definition
from drivers.ndi_polaris.session import Session
from drivers.ndi_polaris.tool_check import check_handle
from drivers.ndi_polaris.volume import MeasuringVolume, parse_volumes
from ronna_hw.errors import ProtocolError
from ronna_hw.wire.polaris import (
    COMM_BAUD_CODES,
    COMM_DEFAULT_ARGUMENT,
    HANDLE_DIGITS,
    ILLUMINATOR_RATES_HZ,
    PARAMETER_ILLUMINATOR_RATE,
    PARAMETER_SELECTED_VOLUME,
    PHRQ_ANY_PASSIVE,
    PVWR_BLOCK_BYTES,
    REPLY_OKAY,
    SFLIST_VOLUMES,
    HandleQuery,
    PortStatus,
    TrackingPriority,
)

RATE_SETTLING_S = 0.1  # from OKAY to COMM until the unit listens at the new rate, as other clients wait
DUMMY_PASSIVE_PORT = PHRQ_ANY_PASSIVE[:-4] + "**01"  # lights the illuminators without a tool
PHSR_STATUS_DIGITS = 3
SFLIST_BYTES = 1024


@dataclass(frozen=True)
class LoadedTool:
    """A tool and the handle that the unit gave it; the dummy tool has neither name nor definition."""

    handle: int
    name: str | None
    definition: ToolDefinition | None

    @cached_property
    def reach_mm(self) -> float:
        """Distance of the farthest marker from the tool's origin."""
        markers_mm = self.definition.markers_mm if self.definition else ()
        return max((math.hypot(*marker) for marker in markers_mm), default=0.0)


def raise_baud(
    session: Session, maximum: int, deadline_s: float, pause: Callable[[float], None] = time.sleep
) -> int | None:
    """Go to the fastest rate that both ends can do, and prove it by a command; None over TCP.

    A unit that is lost at a rate which the cable does not carry is looked for again, if need be by a break,
    and a slower rate tried. Raises NDI-002 or NDI-003 when it is not found any more.
    """
    if session.transport.baud is None:
        return None
    for code, baud in sorted(COMM_BAUD_CODES.items(), key=lambda item: -item[1]):
        if baud > maximum:
            continue
        if baud <= session.transport.baud:
            break
        try:
            if _switch(session, code, baud, session.transport.baud, deadline_s, pause):
                break
        except LinkLost:
            find_unit(session, deadline_s)
            initialise(session, deadline_s)
    return session.transport.baud


def _switch(
    session: Session, code: str, baud: int, present: int, deadline_s: float, pause: Callable[[float], None]
) -> bool:
    try:  # our own end first: a unit that has switched to a rate we cannot do would be lost
        session.transport.set_baud(baud)
        session.transport.set_baud(present)
    except PortUnavailable:
        session.transport.set_baud(present)
        return False
    try:
        session.ask("COMM", code + COMM_DEFAULT_ARGUMENT[1:], deadline_s=deadline_s, retry=False)
    except UnitError:
        return False
    except (ProtocolError, NoReply):
        pass  # the answer was lost: only trying tells whether the unit has switched
    pause(RATE_SETTLING_S)
    session.transport.set_baud(baud)
    if answers(session, deadline_s):
        return True
    session.transport.set_baud(present)
    if not answers(session, deadline_s):
        raise LinkLost(f"the unit answers neither at {baud} baud nor at {present}")
    return False


def choose_volume(session: Session, wanted: int | None, deadline_s: float) -> MeasuringVolume | None:
    """Select volume number `wanted` (from 1) if given; the volume in use, or None if the unit cannot say."""
    if wanted is not None:
        session.ask("VSEL", f"{wanted}", deadline_s=deadline_s)
    try:
        volumes = parse_volumes(
            session.ask("SFLIST", SFLIST_VOLUMES, deadline_s=deadline_s, reply_bytes=SFLIST_BYTES)
        )
    except (UnitError, MalformedReply):
        return None
    index = wanted - 1 if wanted is not None else _selected(session, deadline_s)
    return volumes[index] if 0 <= index < len(volumes) else None


def _selected(session: Session, deadline_s: float) -> int:
    try:
        value = read_parameter(session, PARAMETER_SELECTED_VOLUME, deadline_s)
    except UnitError:
        return 0
    return int(value) if value.isdecimal() else 0


def set_illuminator_rate(session: Session, rate_hz: int, deadline_s: float) -> int:
    """Set the rate by SET, or IRATE on older firmware; the rate that the unit then has, in Hz."""
    code = next(code for code, rate in ILLUMINATOR_RATES_HZ.items() if rate == rate_hz)
    for name, argument in (("SET", f"{PARAMETER_ILLUMINATOR_RATE}={code}"), ("IRATE", f"{code}")):
        try:
            session.ask(name, argument, deadline_s=deadline_s)
        except UnitError:
            continue
        return rate_hz
    try:
        value = read_parameter(session, PARAMETER_ILLUMINATOR_RATE, deadline_s)
    except UnitError:
        value = ""
    kept = int(value) if value.isdecimal() else min(ILLUMINATOR_RATES_HZ)
    return ILLUMINATOR_RATES_HZ.get(kept, min(ILLUMINATOR_RATES_HZ.values()))


def free_handles(session: Session, deadline_s: float | None) -> None:
    """Free every handle that the unit has given out, to us or to an earlier client."""
    for handle in list_handles(session, HandleQuery.ALL, deadline_s):
        free_handle(session, handle, deadline_s)


def free_handle(session: Session, handle: int, deadline_s: float | None) -> None:
    """Free one handle; a handle that is free already is no error."""
    try:
        session.ask("PHF", f"{handle:02X}", deadline_s=deadline_s)
    except HandleRefused:
        return


def list_handles(session: Session, query: HandleQuery, deadline_s: float | None) -> dict[int, PortStatus]:
    """Handles of one kind with their status, from PHSR."""
    text = session.ask("PHSR", f"{query.value:02X}", deadline_s=deadline_s, reply_bytes=2048)
    width = HANDLE_DIGITS + PHSR_STATUS_DIGITS
    try:
        count = int(text[:2], 16)
        records = [text[2 + k * width : 2 + (k + 1) * width] for k in range(count)]
        handles = {int(r[:HANDLE_DIGITS], 16): PortStatus(int(r[HANDLE_DIGITS:], 16)) for r in records}
    except ValueError as error:
        raise MalformedReply("PHSR has an unknown form", wire=text.encode()) from error
    if len(text.rstrip()) != 2 + count * width or len(handles) != count:
        raise MalformedReply(f"PHSR announces {count} handles and sends others", wire=text.encode())
    return handles


def load_tools(
    session: Session,
    tools: Iterable[tuple[ToolOption, ToolDefinition]],
    deadline_s: float,
    note: Callable[[str], None],
) -> tuple[LoadedTool, ...]:
    """Free all handles, then load, initialise and enable each tool; `note` receives warnings.

    Without tools the dummy passive tool is loaded, because a unit sees strays only while a passive handle
    is enabled. A reply lost to PHRQ starts the loading over once, since asking twice would leave a handle
    without owner. Raises NDI-03x of the tool that is refused, NDI-013 when the unit holds another one.
    """
    wanted = tuple(tools)
    try:
        return _load(session, wanted, deadline_s, note)
    except (BadReplyCrc, MalformedReply, NoReply):
        return _load(session, wanted, deadline_s, note)


def _load(
    session: Session,
    tools: tuple[tuple[ToolOption, ToolDefinition], ...],
    deadline_s: float,
    note: Callable[[str], None],
) -> tuple[LoadedTool, ...]:
    free_handles(session, deadline_s)
    loaded = []
    for option, definition in tools:
        handle = _request(session, PHRQ_ANY_PASSIVE, deadline_s)
        _write_definition(session, handle, encode_definition(definition), deadline_s)
        _initialise(session, handle, option.name, deadline_s, note)
        if (difference := check_handle(session, handle, option.name, definition, deadline_s)) is not None:
            note(difference)
        session.ask("PENA", f"{handle:02X}{option.priority}", deadline_s=deadline_s)
        loaded.append(LoadedTool(handle, option.name, definition))
    if not loaded:
        handle = _request(session, DUMMY_PASSIVE_PORT, deadline_s)
        _initialise(session, handle, "dummy tool", deadline_s, note)
        session.ask("PENA", f"{handle:02X}{TrackingPriority.DYNAMIC}", deadline_s=deadline_s)
        loaded.append(LoadedTool(handle, None, None))
    enabled = list_handles(session, HandleQuery.ENABLED, deadline_s)
    if missing := [tool for tool in loaded if tool.handle not in enabled]:
        raise MalformedReply(
            "the unit does not list a tool as enabled that it has enabled",
            awaited=", ".join(f"{tool.handle:02X}" for tool in missing),
        )
    return tuple(loaded)


def _request(session: Session, argument: str, deadline_s: float) -> int:
    text = session.ask("PHRQ", argument, deadline_s=deadline_s, retry=False)
    try:
        handle = int(text, 16)
    except ValueError as error:
        raise MalformedReply("PHRQ gives no handle", wire=text.encode()) from error
    if not handle:
        raise MalformedReply("PHRQ gives the handle 00", wire=text.encode())
    return handle


def _write_definition(session: Session, handle: int, block: bytes, deadline_s: float) -> None:
    for address in range(0, len(block), PVWR_BLOCK_BYTES):
        chunk = block[address : address + PVWR_BLOCK_BYTES].ljust(PVWR_BLOCK_BYTES, b"\0")
        session.ask("PVWR", f"{handle:02X}{address:04X}{chunk.hex().upper()}", deadline_s=deadline_s)


def _initialise(
    session: Session, handle: int, name: str, deadline_s: float, note: Callable[[str], None]
) -> None:
    reply = session.ask("PINIT", f"{handle:02X}", deadline_s=deadline_s)
    if (warning := warning_meaning(reply)) is not None:
        note(f"{name}: {warning}")
    elif reply != REPLY_OKAY:
        raise MalformedReply("PINIT has an unknown answer", wire=reply.encode())
