"""Faults of the optical tracker."""

from __future__ import annotations

from collections.abc import Iterator

from sim.theatre.faults.kinds import Arguments, FaultKind
from sim.theatre.scene import Scene


def _marker(arguments: Arguments, scene: Scene) -> Iterator[str]:
    markers = [str(fiducial.number) for fiducial in scene.head.fiducials]
    if arguments[0] not in markers:
        yield f"there is no marker {arguments[0]}, only {', '.join(markers)}"


def _tool(arguments: Arguments, scene: Scene) -> Iterator[str]:
    tools = [tool.name for tool in scene.tracker.tools]
    known = {*tools, *(tool.part_number for tool in scene.tracker.tools)}
    # Where there are places for other tools, a client may load definitions that the scene does not know.
    if not scene.tracker.places and arguments[0] not in known:
        yield f"there is no tool {arguments[0]!r}, only {', '.join(tools)}"


TRACKER_FAULTS = (
    FaultKind(
        "occlude_marker", "tracker", "occlude marker INT", "A fiducial on the head is hidden.", check=_marker
    ),
    FaultKind(
        "occlude_tool", "tracker", "occlude tool NAME", "All markers of a tool are hidden.", check=_tool
    ),
)
