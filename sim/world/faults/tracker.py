"""Tracker fault kinds: sensor view, unit, and line to the host."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from ronna_hw.wire.polaris import MAXIMUM_STRAYS
from sim.world.faults.fault import (
    Arguments,
    Fault,
    FaultKinds,
    OneOf,
    check_at_most,
    fiducial_number,
    unless_known,
)
from sim.world.scene.model import Scene, TrackerTool

SLOW_COMMANDS = ("INIT", "PINIT", "TSTART")
SOCKETS = ("1", "2", "3")  # for wired tools
# Bits of Info.Status.Alerts with a defined meaning.
KNOWN_ALERTS = tuple(str(bit) for bit in (*range(9), *range(20, 27), 29, 30))
_HIDE = re.compile(r"\b(tracker) hide\b")
_NUMBERED_TOOL = re.compile(r"\b(tracker \w+ tool )([0-9]{1,2})(?= |$)")
TRACKER = FaultKinds("tracker")
declare_lasting, declare_momentary = TRACKER.declare_lasting, TRACKER.declare_momentary


def _tools(name: str, scene: Scene) -> list[TrackerTool]:
    return [tool for tool in scene.tracker.tools if name in (tool.name, tool.part_number)]


def _check_tool(arguments: Arguments, scene: Scene) -> Iterator[str]:
    # With places for other tools, a client may load definitions unknown to the scene.
    if not scene.tracker.places and not _tools(arguments[0], scene):
        yield from unless_known("tool", [tool.name for tool in scene.tracker.tools], arguments[0])


def _check_tool_marker(arguments: Arguments, scene: Scene) -> Iterator[str]:
    yield from _check_tool(arguments, scene)
    for tool in _tools(arguments[0], scene):
        numbers = [str(number) for number in range(1, len(tool.markers_mm) + 1)]
        yield from unless_known(f"{tool.name} marker", numbers, arguments[1])


def check_tool_is_there(fault: Fault, scene: Scene, loaded: Sequence[str]) -> Iterator[str]:
    """Check that the fault's tool is in the scene or loaded by a client."""
    if {_check_tool, _check_tool_marker}.intersection(fault.kind.checks) and not _tools(
        fault.argument, scene
    ):
        known = [*(tool.name for tool in scene.tracker.tools), *loaded]
        yield from unless_known("tool", list(dict.fromkeys(known)), fault.argument)


def name_tool(line: str, scene: Scene, loaded: Sequence[str] | None) -> str:
    """Return a line typed at the control port as scripts write it.

    A client knows its tools by number, counted from 1 in the order in which it has loaded them: the number is
    replaced by the tool's name. To hide a tool is to occlude it.
    """
    named = [tool.name for tool in scene.tracker.tools] if loaded is None else loaded

    def name(found: re.Match[str]) -> str:
        number = int(found[2])
        is_number = not _tools(found[2], scene) and 0 < number <= len(named)
        return f"{found[1]}{named[number - 1]}" if is_number else found[0]

    return _NUMBERED_TOOL.sub(name, _HIDE.sub(r"\1 occlude", line))


def _check_visible_fiducial(arguments: Arguments, scene: Scene) -> Iterator[str]:
    if not scene.tracker.fiducials_visible:
        yield f"expected a scene with markers on a head, got {scene.name}: marker {arguments[0]} is not in it"
        return
    yield from fiducial_number(arguments, scene)


_few = check_at_most(MAXIMUM_STRAYS, "strays, the most that the unit can report")
_socket = OneOf("socket", SOCKETS)

DISPLACED_TOOLS = (
    declare_lasting(
        "bend_tool",
        "bend tool NAME NUMBER mm",
        "The last marker of a tool is displaced outwards by that distance.",
        _check_tool,
    ),
    declare_lasting(
        "turn_tool",
        "turn tool NAME SIGNED deg",
        "A tool is rotated by that angle about its own x axis.",
        _check_tool,
    ),
    declare_lasting(
        "move_tool",
        "move tool NAME SIGNED SIGNED SIGNED mm",
        "A tool is moved along x, y and z of the tracker.",
        _check_tool,
    ),
)
SIGHT_FAULTS = (
    declare_lasting(
        "occlude_marker", "occlude marker INT", "A fiducial on the head is hidden.", _check_visible_fiducial
    ),
    declare_lasting("occlude_tool", "occlude tool NAME", "All markers of a tool are hidden.", _check_tool),
    declare_lasting(
        "occlude_tool_marker",
        "occlude tool NAME marker INT",
        "One marker of a tool is hidden; markers count from 1.",
        _check_tool_marker,
    ),
    *DISPLACED_TOOLS,
    declare_lasting(
        "interference", "interference tool NAME", "Infrared interference on one tool.", _check_tool
    ),
    declare_lasting("sunlight", "sunlight", "Sunlight: too much infrared, more noise, reflections."),
    declare_lasting("strays", "strays INT", "That many additional spheres are in the volume.", _few),
    declare_lasting(
        "reflections", "reflections INT", "That many additional surfaces reflect intermittently.", _few
    ),
    declare_lasting(
        "phantoms",
        "phantoms NUMBER mm",
        "Rays that pass this close to each other are taken for one marker: phantom markers.",
    ),
)

UNIT_FAULTS = (
    declare_momentary("bump", "bump", "The unit was bumped: no poses until the host reads the alert."),
    declare_lasting("cold", "cold", "The unit has not warmed up: no poses."),
    declare_lasting("hot", "hot", "The unit is too hot: no poses."),
    declare_lasting(
        "alert",
        "alert INT",
        "That alert bit is set; 0 to 8 are faults of the hardware.",
        OneOf("alert", KNOWN_ALERTS),
    ),
    declare_lasting(
        "power_off", "power off", "The unit has no power; when it returns, it sends RESET at 9600 baud."
    ),
    declare_momentary("unit_restart", "restart", "The unit restarts at once."),
    declare_momentary("watchdog", "watchdog", "The unit assumes that the host is gone and stops tracking."),
    declare_lasting(
        "plug", "plug INT", "A wired tool is plugged into that socket, and unplugged at the end.", _socket
    ),
    declare_lasting(
        "unplug",
        "unplug INT",
        "The wired tool in that socket is unplugged, and plugged in again at the end.",
        _socket,
    ),
    declare_lasting(
        "corrupt_definitions",
        "corrupt definitions",
        "A tool definition is found corrupt when it is initialised.",
    ),
    declare_lasting("enabled_limit", "allow INT tools", "At most that many tools can be enabled."),
    declare_lasting("handle_limit", "allow INT handles", "At most that many port handles are available."),
    declare_lasting(
        "wavelength", "wrong wavelength", "The selected volume does not accept the wavelength of any tool."
    ),
    declare_lasting(
        "slow",
        "slow NAME NUMBER s",
        "INIT, PINIT or TSTART takes that much longer.",
        OneOf("command", SLOW_COMMANDS),
    ),
    declare_lasting("repeat_frames", "repeat frames", "The unit sends the same frame repeatedly."),
    declare_lasting("skip_frames", "skip INT frames", "After each frame the unit skips that many."),
)

LINE_FAULTS = (
    declare_lasting(
        "garble_commands", "garble commands NUMBER %", "That share of the commands arrives with a bit error."
    ),
    declare_lasting(
        "garble_replies", "garble replies NUMBER %", "That share of the replies arrives with a bit error."
    ),
    declare_lasting("drop_bytes", "drop bytes NUMBER %", "That share of the replies loses a byte."),
    declare_lasting(
        "double_bytes", "double bytes NUMBER %", "That share of the replies has a duplicated byte."
    ),
    declare_lasting("cut_replies", "cut replies NUMBER %", "That share of the replies is truncated."),
    declare_lasting("lose_replies", "lose replies NUMBER %", "That share of the replies is never sent."),
    declare_lasting("late_replies", "delay replies NUMBER s", "Each reply is delayed by that much."),
)

TRACKER_FAULTS = (*SIGHT_FAULTS, *UNIT_FAULTS, *LINE_FAULTS)
