"""Port handles of the unit: request, list, free."""

from __future__ import annotations

from drivers.ndi_polaris.errors import HandleRefused, MalformedReply
from drivers.ndi_polaris.line.command_link import CommandLink
from ronna_hw.wire.polaris import HANDLE_DIGITS, HandleQuery, PortStatus

PHSR_STATUS_DIGITS = 3
PHSR_BYTES = 2048  # more than 255 handles of five digits each


def request_handle(link: CommandLink, argument: str, deadline_s: float) -> int:
    """A new handle by PHRQ, which is never repeated: a lost reply would leak a handle."""
    text = link.ask("PHRQ", argument, deadline_s=deadline_s, retry=False)
    try:
        handle = int(text, 16)
    except ValueError as error:
        raise MalformedReply("PHRQ returned no handle", wire=text.encode()) from error
    if not handle:
        raise MalformedReply("PHRQ returned handle 00", wire=text.encode())
    return handle


def free_handles(link: CommandLink, deadline_s: float | None) -> None:
    """Free every allocated handle, ours or an earlier client's."""
    for handle in list_handles(link, HandleQuery.ALL, deadline_s):
        free_handle(link, handle, deadline_s)


def free_handle(link: CommandLink, handle: int, deadline_s: float | None) -> None:
    """Free one handle; freeing a free one is not an error."""
    try:
        link.ask("PHF", f"{handle:02X}", deadline_s=deadline_s)
    except HandleRefused:
        return


def list_handles(link: CommandLink, query: HandleQuery, deadline_s: float | None) -> dict[int, PortStatus]:
    """Handles selected by a PHSR query, with their status."""
    text = link.ask("PHSR", f"{query.value:02X}", deadline_s=deadline_s, reply_bytes=PHSR_BYTES)
    width = HANDLE_DIGITS + PHSR_STATUS_DIGITS
    try:
        count = int(text[:2], 16)
        records = [text[2 + k * width : 2 + (k + 1) * width] for k in range(count)]
        handles = {int(r[:HANDLE_DIGITS], 16): PortStatus(int(r[HANDLE_DIGITS:], 16)) for r in records}
    except ValueError as error:
        raise MalformedReply("unknown form of PHSR", wire=text.encode()) from error
    if len(text.rstrip()) != 2 + count * width or len(handles) != count:
        raise MalformedReply(f"PHSR announces {count} handles but sends another number", wire=text.encode())
    return handles
