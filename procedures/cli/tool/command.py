"""`ronna-tool`: define, check and list the tool records of a theatre file."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Annotated, Any

from typer import Argument, Option

from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.tool_record import ToolPurpose

app = terminal.command_group(
    "ronna-tool",
    "The tools of an arm: define, check and list their records.",
    example="ronna-tool list --config theatre.toml",
)
ConfigOption = Annotated[Path, Option(metavar="FILE", help="The theatre file.")]
DaysOption = Annotated[int, Option(min=1, max=366, help="Validity of the record.")]
SixDegrees = tuple[float, float, float, float, float, float]
GaugeFile = Option(
    metavar="FILE",
    help="The gauge's dials as read with this tool: X Y Z UPPER_X UPPER_Y, one line for each approach.",
)


@app.command()
def define(
    name: Annotated[str, Argument(help="Its name in the theatre file; the procedure uses `guide`.")],
    config: ConfigOption,
    purpose: Annotated[ToolPurpose, Option(help="What the tool is for.")],
    number: Annotated[int, Option(min=1, max=16, help="Tool number reported by the controller's inputs.")],
    mass_kg: Annotated[float, Option(help="Mass of everything below the tool changer.")],
    centre_of_gravity_mm: Annotated[
        tuple[float, float, float], Option(metavar="X Y Z", help="Centre of gravity in the flange frame.")
    ],
    by: Annotated[str, Option(metavar="NAME", help="Who measured it.")],
    flange: Annotated[
        str | None, Option(help="Flange or tool changer it was measured on [default: the file's].")
    ] = None,
    reach_mm: Annotated[
        float | None, Option(help="Of a guide: distance from its lower end to its mandrel's.")
    ] = None,
    bore_mm: Annotated[float | None, Option(help="Of a guide: length of its bore.")] = None,
    play_mm: Annotated[
        float | None, Option(help="Of a guide: bore diameter minus instrument diameter.")
    ] = None,
    gauge_deg: Annotated[
        SixDegrees | None,
        Option(metavar="A1 ... A6", help="Of a guide: axis angles with the mandrel in the gauge."),
    ] = None,
    gauge_base_mm: Annotated[
        float, Option(help="Distance between the two heights of the gauge's dials.")
    ] = 60.0,
    gauge_mm: Annotated[Path | None, GaugeFile] = None,
    days: DaysOption = 180,
    as_json: terminal.JsonOption = False,
) -> None:
    """Put the record of a tool into the theatre file. Its tip is that of the file's current calibration.

    Bodies for clearance are added by hand, as `[[tools.NAME.bodies]]`. Exit codes: 0 done, 2 usage, or the
    file or the record has mistakes, 3 --by is no name, or a run uses the theatre.
    """
    from procedures.cli.tool.records import record_of

    signed = _identity_fields(name, by, days)
    guide = {"reach_mm": reach_mm, "length_mm": bore_mm, "play_mm": play_mm}
    bore = {key: value for key, value in guide.items() if value is not None}
    gauge = {} if gauge_deg is None else {"joints_deg": list(gauge_deg), "base_mm": gauge_base_mm}
    weight = {"mass_kg": mass_kg, "centre_of_gravity_mm": list(centre_of_gravity_mm)}
    given = {**signed, "purpose": purpose.value, "number": number, "flange": flange, **weight}
    record, dropped = record_of(config, {**given, "bore": bore, "gauge": gauge}, name, gauge_mm)
    if dropped:
        terminal.tell(
            f"the former record of {name} had {', '.join(dropped)}, which the new one has not: "
            "copy what this tool still has, or the case does without"
        )
    _update(config, name, record, "ronna-tool define", as_json=as_json)


@app.command()
def renew(
    name: Annotated[str, Argument(help="Its name in the theatre file.")],
    config: ConfigOption,
    gauge_mm: Annotated[Path, GaugeFile],
    by: Annotated[str, Option(metavar="NAME", help="Who read them.")],
    days: DaysOption = 180,
    as_json: terminal.JsonOption = False,
) -> None:
    """After a tip calibration: renew a tool's record for the new tip and the present gauge readings.

    A calibration does not change the record: a person must confirm, with the gauge, that this tool is the one
    whose tip was calibrated. Exit codes as in `define`.
    """
    from procedures.cli.tool.records import renew_record

    record, remarks = renew_record(config, name, _identity_fields(name, by, days), gauge_mm)
    for remark in remarks:
        terminal.tell(remark)
    _update(config, name, record, "ronna-tool renew", as_json=as_json)


def _identity_fields(name: str, by: str, days: int) -> dict[str, Any]:
    from ronna_hw.devices.lifecycle import require_person

    now = datetime.now(UTC)
    made = now.replace(microsecond=0)
    return {
        "identifier": f"{name}-{now:%Y%m%dT%H%M%S.%f}",  # two in the same second are two records
        "created": made,
        "expires": made + timedelta(days=days),
        "made_by": require_person(by),
    }


def _update(config: Path, name: str, record: dict[str, Any], command: str, *, as_json: bool) -> None:
    from procedures.runs.theatre_history import UpdateAuthor, update_tables
    from procedures.runs.theatre_lock import require_free_theatre
    from ronna_hw.config import read_theatre_file

    require_free_theatre(config)  # a run would find its records changed
    former = read_theatre_file(config).tools.get(name)
    replaced = None if former is None else former.identifier
    update_tables(config, {"tools": {name: record}}, UpdateAuthor(command, by=record["made_by"]))
    if as_json:
        written = {"name": name, "identifier": record["identifier"], "replaced": replaced}
        terminal.print_json({**written, "theatre_file": str(config)})
    else:
        place = f"{config}" if replaced is None else f"{config} instead of {replaced}"
        terminal.say(f"{record['identifier']} is now in {place}; until {record['expires']:%Y-%m-%d}")


@app.command()
def check(config: ConfigOption) -> None:
    """Check the records of a theatre file as a case does: valid, for this flange and this tip.

    The calibrations that they rely on must be valid too. Exit codes: 0 they match, 2 usage, or the file has
    mistakes, 3 refused.
    """
    from procedures.calibration.validity import options_of, require_valid
    from procedures.planning.tool_records import ToolRecords
    from ronna_hw.config import read_theatre_file

    theatre = read_theatre_file(config)
    if theatre.calibration is None:
        raise UsageMistake(
            f"{config.name} has no [calibration] to check the tools against",
            action="Calibrate first: ronna-procedure calibrate tool-tip --config FILE --update.",
        )
    tools, now = ToolRecords.of(theatre), datetime.now(UTC)
    require_valid(theatre.calibration, now, options_of(config))
    tools.check(theatre.calibration, now)
    terminal.say(f"{', '.join(one.identifier for one in tools.records.values())}: fit")


@app.command(name="list")
def list_tools(config: ConfigOption, as_json: terminal.JsonOption = False) -> None:
    """List the tools of a theatre file."""
    from procedures.cli.tool.records import row_of
    from ronna_hw.config import read_theatre_file

    theatre, now = read_theatre_file(config), datetime.now(UTC)
    rows = [row_of(name, record, theatre.flange, now) for name, record in theatre.tools.items()]
    if as_json:
        terminal.print_json({"flange": theatre.flange, "tools": rows})
        return
    title, headings = f"tools on {theatre.flange or 'an unnamed flange'}", list(rows[0]) if rows else ["name"]
    terminal.print_table(title, headings, [list(row.values()) for row in rows])


def main() -> None:
    terminal.run(app)
