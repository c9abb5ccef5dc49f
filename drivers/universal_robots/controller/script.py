"""Our script as it is sent to the controller, with its settings filled in."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files

from ronna_hw.wire.universal_robots import ScriptSettings

FILE_NAME = "ronna_stream.script"
WATCHDOG_HZ = 10.0  # least rate of packages: slower than the script's own limit, faster than a person
INDENT = "\n  "


def render_script(settings: ScriptSettings, commands: Sequence[str] = ()) -> str:
    """Return the script with these settings; the commands, such as a payload, come first."""
    template = (files(__package__) / FILE_NAME).read_text("ascii")
    lines = INDENT.join(f"{name} = {value:g}" for name, value in settings._asdict().items())
    return template.format(settings=lines, payload=INDENT.join(commands), watchdog_hz=f"{WATCHDOG_HZ:g}")


def render_secondary(commands: Sequence[str]) -> str:
    """Return a secondary program, which the controller runs beside ours without moving the arm."""
    return f"sec ronna_load():{INDENT}{INDENT.join(commands)}\nend\n"
