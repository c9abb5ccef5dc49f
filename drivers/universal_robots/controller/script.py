"""Our script as it is sent to the controller, with its settings filled in."""

from __future__ import annotations

from importlib.resources import files

from ronna_hw.wire.universal_robots import ScriptSettings

FILE_NAME = "ronna_stream.script"
WATCHDOG_HZ = 10.0  # least rate of packages: slower than the script's own limit, faster than a person
INDENT = "\n  "


def render_script(settings: ScriptSettings, payload_kg: float | None = None) -> str:
    """Return the script with these settings, and with the payload on the flange if it is to be set."""
    template = (files(__package__) / FILE_NAME).read_text("ascii")
    lines = INDENT.join(f"{name} = {value:g}" for name, value in settings._asdict().items())
    payload = "" if payload_kg is None else f"set_payload({payload_kg:g})"
    return template.format(settings=lines, payload=payload, watchdog_hz=f"{WATCHDOG_HZ:g}")
