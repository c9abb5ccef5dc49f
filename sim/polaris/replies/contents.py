"""Which parts of a frame a reply contains, as text or as bytes."""

from __future__ import annotations

from ronna_hw.wire.polaris import PortStatus, ReplyOption, ToolInformation
from sim.polaris.measurement.frame import Stray
from sim.polaris.measurement.tracking_rules import Tracked, as_asked
from sim.polaris.tools.ports import Port
from sim.polaris.unit.behaviour import UnitBehaviour

MARKER_DIGITS = 20  # option 0002 always sends this many
Point = tuple[float, float, float]


def reported_tool(tracked: Tracked | None, options: ReplyOption, behaviour: UnitBehaviour) -> Tracked | None:
    """The tool as reported: outside the volume, request and unit decide what is omitted."""
    if tracked is None or not tracked.volume_status:
        return tracked
    outside = bool(options & ReplyOption.OUT_OF_VOLUME)
    return as_asked(tracked, outside=outside, partially_outside=behaviour.poses_partially_out)


def port_status(port: Port, tracked: Tracked | None) -> int:
    """Port status of a handle in TX and BX."""
    return int(port.status | (tracked.volume_status if tracked is not None else PortStatus(0)))


def information(tracked: Tracked | None) -> int:
    """The tool information byte."""
    return int(ToolInformation.TOO_FEW_MARKERS) if tracked is None else tracked.information


def marker_digits(tracked: Tracked | None, *, first_first: bool) -> str:
    """One digit per marker."""
    digits = "" if tracked is None else "".join(map(str, tracked.marker_digits))
    digits = digits.ljust(MARKER_DIGITS, "0")
    return digits if first_first else digits[::-1]


def seen_markers(tracked: Tracked | None) -> list[tuple[Point, bool]]:
    """(position, inside the volume) of each measured marker of a tool."""
    if tracked is None:
        return []
    pairs = zip(tracked.markers_mm, tracked.markers_inside, strict=True)
    return [(position, inside) for position, inside in pairs if position is not None]


def reported_strays(strays: tuple[Stray, ...], options: ReplyOption) -> tuple[Stray, ...]:
    """The strays whose positions are sent: those inside the volume, or all with option 0800."""
    if options & ReplyOption.OUT_OF_VOLUME:
        return strays
    return tuple(stray for stray in strays if stray.inside)
