"""The pages of the drivers' options: each key of `[DEVICE.options]`, its default and its meaning."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from pydantic import BaseModel

from drivers.basler_stereo.options import BaslerOptions
from drivers.kuka_rsi.options import KukaOptions
from drivers.ndi_polaris.options import PolarisOptions

TRACKER_HEAD = """# Options of the driver `ndi_polaris`

Set in `[tracker.options]` of the theatre file. Unknown options are errors.
"""
ROBOT_HEAD = """# Options of the driver `kuka_rsi`

Set in `[robot.NAME.options]` of the theatre file. Unknown options are errors.
Times are host time; fractions are of full axis speed.
"""
STEREO_HEAD = """# Options of the driver `basler_stereo`

Set in `[stereo.options]` of the theatre file. Unknown options are errors. The driver
`basler_pylon` accepts them too, but leaves packets, resends and heartbeat to the vendor's library.
"""


def option_pages() -> dict[str, str]:
    """File name -> content of the page of every driver."""
    return {
        "robot-options.md": _page(ROBOT_HEAD, KukaOptions),
        "stereo-options.md": _page(STEREO_HEAD, BaslerOptions),
        "tracker-options.md": _page(TRACKER_HEAD, PolarisOptions),
    }


def _page(head: str, options: type[BaseModel]) -> str:
    schema = options.model_json_schema()
    tables = sorted(
        (n, d) for n, d in schema.get("$defs", {}).items() if "properties" in d
    )  # not the choices
    lines = [head]
    for name, definition in ((options.__name__, schema), *tables):
        if tables:
            lines += [f"## {name}\n", definition["description"] + "\n"]
        lines += ["| key | default | meaning |", "|---|---|---|", *_rows(definition), ""]
    return "\n".join(lines)


def _rows(definition: dict[str, Any]) -> Iterable[str]:
    for key, value in definition["properties"].items():
        default = "needed" if key in definition.get("required", []) else value.get("default", {})
        choices = [str(choice) for one in (value, *value.get("anyOf", [])) for choice in one.get("enum", [])]
        among = f" One of {', '.join(choices)}." if choices else ""
        shown = "none" if default is None else default if default != "" else "empty"
        yield f"| `{key}` | {shown} | {value['description']}{among} |"
