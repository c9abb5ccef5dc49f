"""Faults of the optical tracker: what its sensors see, the unit itself, and its line to the host."""

from __future__ import annotations

from collections.abc import Iterator

from ronna_hw.wire.polaris import MAXIMUM_STRAYS
from sim.theatre.faults.kinds import Arguments, FaultKind, at_most_all
from sim.theatre.scene.model import Scene, TrackerTool

SLOW_COMMANDS = ("INIT", "PINIT", "TSTART")
SOCKETS = 3  # of the unit for wired tools that can be connected
KNOWN_ALERTS = (*range(9), *range(20, 27), 29, 30)  # bits of Info.Status.Alerts that have a meaning


def _marker(arguments: Arguments, scene: Scene) -> Iterator[str]:
    markers = [str(fiducial.number) for fiducial in scene.head.fiducials]
    if arguments[0] not in markers:
        yield f"there is no marker {arguments[0]}, only {', '.join(markers)}"


def _tools(name: str, scene: Scene) -> list[TrackerTool]:
    return [tool for tool in scene.tracker.tools if name in (tool.name, tool.part_number)]


def _tool(arguments: Arguments, scene: Scene) -> Iterator[str]:
    # Where there are places for other tools, a client may load definitions that the scene does not know.
    if not scene.tracker.places and not _tools(arguments[0], scene):
        names = ", ".join(tool.name for tool in scene.tracker.tools)
        yield f"there is no tool {arguments[0]!r}, only {names}"


def _tool_marker(arguments: Arguments, scene: Scene) -> Iterator[str]:
    yield from _tool(arguments, scene)
    for tool in _tools(arguments[0], scene):
        if not 1 <= int(arguments[1]) <= len(tool.markers_mm):
            yield f"there is no marker {arguments[1]} on {tool.name}, only 1 to {len(tool.markers_mm)}"


def _alert(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    if int(arguments[0]) not in KNOWN_ALERTS:
        yield f"there is no alert {arguments[0]}, only {', '.join(map(str, KNOWN_ALERTS))}"


def _socket(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    if not 1 <= int(arguments[0]) <= SOCKETS:
        yield f"there is no socket {arguments[0]}, only 1 to {SOCKETS}"


def _slow(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    if arguments[0] not in SLOW_COMMANDS:
        yield f"there is no slow command {arguments[0]!r}, only {', '.join(SLOW_COMMANDS)}"


def _few(arguments: Arguments, _scene: Scene) -> Iterator[str]:
    if int(arguments[0]) > MAXIMUM_STRAYS:
        yield f"{arguments[0]} are more than the unit can tell: {MAXIMUM_STRAYS}"


def _lasting(name: str, phrase: str, meaning: str) -> FaultKind:
    return FaultKind(name, "tracker", phrase, meaning)


def _of_tool(name: str, phrase: str, meaning: str) -> FaultKind:
    return FaultKind(name, "tracker", phrase, meaning, check=_tool)


def _share(name: str, phrase: str, meaning: str) -> FaultKind:
    return FaultKind(name, "tracker", phrase, meaning, check=at_most_all)


def _once(name: str, phrase: str, meaning: str) -> FaultKind:
    return FaultKind(name, "tracker", phrase, meaning, momentary=True)


SIGHT_FAULTS = (
    FaultKind(
        "occlude_marker", "tracker", "occlude marker INT", "A fiducial on the head is hidden.", check=_marker
    ),
    _of_tool("occlude_tool", "occlude tool NAME", "All markers of a tool are hidden."),
    FaultKind(
        "occlude_tool_marker",
        "tracker",
        "occlude tool NAME marker INT",
        "One marker of a tool is hidden; they count from 1.",
        check=_tool_marker,
    ),
    _of_tool(
        "bend_tool",
        "bend tool NAME NUMBER mm",
        "The last marker of a tool is displaced outwards by that distance.",
    ),
    _of_tool(
        "turn_tool", "turn tool NAME SIGNED deg", "A tool is turned by that angle about its own x axis."
    ),
    _of_tool(
        "move_tool",
        "move tool NAME SIGNED SIGNED SIGNED mm",
        "A tool is moved along x, y and z of the tracker.",
    ),
    _of_tool("interference", "interference tool NAME", "Infrared interference on one tool."),
    _lasting("sunlight", "sunlight", "Sunlight: too much infrared, more noise, reflections."),
    FaultKind(
        "strays", "tracker", "strays INT", "That many additional spheres lie in the volume.", check=_few
    ),
    FaultKind(
        "reflections",
        "tracker",
        "reflections INT",
        "That many additional surfaces glint now and then.",
        check=_few,
    ),
    _lasting(
        "phantoms",
        "phantoms NUMBER mm",
        "Rays that pass this close to each other count as one marker: phantom markers.",
    ),
)

UNIT_FAULTS = (
    _once("bump", "bump", "The unit was bumped: no poses until the host has read the alert."),
    _lasting("cold", "cold", "The unit has not warmed up: no poses."),
    _lasting("hot", "hot", "The unit is too hot: no poses."),
    FaultKind(
        "alert",
        "tracker",
        "alert INT",
        "That alert bit is set; 0 to 8 are faults of the hardware.",
        check=_alert,
    ),
    _lasting(
        "power_off", "power off", "The unit has no power; when it returns, it sends RESET at 9600 baud."
    ),
    _once("unit_restart", "restart", "The unit restarts at once."),
    _once("watchdog", "watchdog", "The unit assumes that the host is gone and stops tracking."),
    FaultKind(
        "plug",
        "tracker",
        "plug INT",
        "A wired tool is plugged into that socket, and unplugged at the end.",
        check=_socket,
    ),
    FaultKind(
        "unplug",
        "tracker",
        "unplug INT",
        "The wired tool of that socket is unplugged, and plugged in again at the end.",
        check=_socket,
    ),
    _lasting(
        "corrupt_definitions",
        "corrupt definitions",
        "A tool definition proves corrupt when it is initialised.",
    ),
    _lasting("enabled_limit", "allow INT tools", "At most that many tools can be enabled."),
    _lasting("handle_limit", "allow INT handles", "At most that many port handles are available."),
    _lasting(
        "wavelength", "wrong wavelength", "The selected volume does not accept the wavelength of any tool."
    ),
    FaultKind(
        "slow", "tracker", "slow NAME NUMBER s", "INIT, PINIT or TSTART takes that much longer.", check=_slow
    ),
    _lasting("repeat_frames", "repeat frames", "The unit repeats the same frame."),
    _lasting("skip_frames", "skip INT frames", "After each frame the unit skips that many."),
)

LINE_FAULTS = (
    _share(
        "garble_commands", "garble commands NUMBER %", "That share of the commands arrives with a bit wrong."
    ),
    _share(
        "garble_replies", "garble replies NUMBER %", "That share of the replies arrives with a bit wrong."
    ),
    _share("drop_bytes", "drop bytes NUMBER %", "That share of the replies loses a byte."),
    _share("double_bytes", "double bytes NUMBER %", "That share of the replies has a byte twice."),
    _share("cut_replies", "cut replies NUMBER %", "That share of the replies breaks off."),
    _share("lose_replies", "lose replies NUMBER %", "That share of the replies never comes."),
    _lasting("late_replies", "delay replies NUMBER s", "Each reply comes so much later."),
)

TRACKER_FAULTS = (*SIGHT_FAULTS, *UNIT_FAULTS, *LINE_FAULTS)
