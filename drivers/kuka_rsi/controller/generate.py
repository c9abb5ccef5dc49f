"""Generator of controller files from the RSI context description."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from jinja2 import Environment, PackageLoader, StrictUndefined

from ronna_hw.arm.kr6_r900 import kr6_r900
from ronna_hw.arm.pose import degrees6
from ronna_hw.command_line import terminal
from ronna_hw.wire import kuka_eki
from ronna_hw.wire.kuka_context import AXES, CONTEXT_INVALID, RsiContext, context_hash, load_context

TEMPLATES = {
    "ethernet.xml.j2": "{name}_eth.xml",
    "context.rsi.xml.j2": "{name}.rsi.xml",
    "program.src.j2": "{name}.src",
    "program.dat.j2": "{name}.dat",
    "eki.xml.j2": "ronna_eki.xml",
    "eki.sub.j2": "ronna_eki.sub",
}
STOP_MODES = {"InfoMessage": 0, "PathNormal": 1, "Velocity": 2, "PathFast": 3, "ExitMoveCorr": 4}
IPO_MODES = {4: "#IPO_FAST", 12: "#IPO"}
OBJECT_IDS = {"AXISCORR": 33, "AXISCORRMON": 82, "ETHERNET": 64, "STOP": 18}
OUTPUTS = {"Stat": 1}  # of a correction object, before its axes; RSI 3 files count from 1
FIRST_UPPER_LIMIT_ID = 13  # parameter ids of AXISCORR: 1..6 lower A, 7..12 lower E, 13..18 upper A
CONNECTED_FLAG = 951  # $FLAG numbers of the EKI channel; change both here if the cell uses them
RECEIVED_FLAG = 952
WHOLE_VALUES = (("Val", "val"), ("No", "no"))  # attributes of commands, and the KRL variables for them
REAL_VALUES = (
    *((name, f"given.{name}") for name in ("X", "Y", "Z", "A", "B", "C")),
    *(("M", "mass"), ("CX", "mass_x"), ("CY", "mass_y"), ("CZ", "mass_z")),
)


def render(context: RsiContext) -> dict[str, str]:
    """Render all controller files, keyed by file name.

    Raises WIR-001 for a context that uses objects missing from these files, and jinja2's error when a
    template refers to something undefined.
    """
    used = {wire.object for wire in context.wiring} | {wire.object for wire in context.feedback}
    if unknown := sorted(used - set(OBJECT_IDS)):
        raise CONTEXT_INVALID(
            f"the controller's files have no {', '.join(unknown)}",
            expected="wiring and feedback of AXISCORR and STOP only",
        )
    axis_wires = {w.input: w.indx for w in context.wiring if w.object == "AXISCORR"}
    if (axis_wires or context.feedback) and len(axis_wires) < AXES:
        raise CONTEXT_INVALID("the wiring of AXISCORR is not complete", expected="A1 to A6")
    environment = Environment(
        loader=PackageLoader("drivers.kuka_rsi.controller"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # the values are our own numbers and names
    )
    model = kr6_r900(context.program.variant)
    corrected = {w.indx for w in context.wiring if w.object in ("AXISCORR", "POSCORR")}
    values = {
        "context": context,
        "hash": context_hash(context),
        "axes": range(1, 7),
        "axis_wires": axis_wires,
        "feedback": sorted(context.feedback, key=lambda wire: wire.indx),
        "outputs": OUTPUTS,
        "stop_wire": next((w.indx for w in context.wiring if w.object == "STOP"), None),
        "lower_deg": degrees6(model.lower_rad),
        "upper_deg": degrees6(model.upper_rad),
        "stop_mode": STOP_MODES[context.stop.mode] if context.stop else None,
        "ipo_mode": IPO_MODES[context.program.cycle_ms],
        "object_ids": OBJECT_IDS,
        "first_upper": FIRST_UPPER_LIMIT_ID,
        "holds": int(all(e.holdon == 1 for e in context.receive if e.indx in corrected)),
        "reference": "ABS" if context.program.corrections == "absolute" else "REL",
        "eki_port": kuka_eki.PROJECT_PORT,
        "state_attributes": list(kuka_eki.StateAttribute),
        "codes": kuka_eki.AckCode,
        "first_request_limit_ms": kuka_eki.FIRST_REQUEST_LIMIT_MS,
        "connected_flag": CONNECTED_FLAG,
        "received_flag": RECEIVED_FLAG,
        "whole_values": WHOLE_VALUES,
        "real_values": REAL_VALUES,
    }
    return {
        name.format(name=context.name): environment.get_template(template).render(values)
        for template, name in TEMPLATES.items()
    }


def generate(
    folder: Annotated[Path, typer.Argument(help="Folder for the files.")],
    description: Annotated[Path | None, typer.Option(help="Alternative context description (TOML).")] = None,
) -> None:
    """Write the controller's files."""
    folder.mkdir(parents=True, exist_ok=True)
    for name, text in render(load_context(description)).items():
        (folder / name).write_text(text, encoding="ascii", newline="\r\n")


if __name__ == "__main__":
    app = typer.Typer(add_completion=False, rich_markup_mode=None)
    app.command()(generate)
    terminal.run(app)
