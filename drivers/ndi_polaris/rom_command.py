"""`ronna-rom`: write, show, compare and check the tool definitions (.rom) of an NDI tracker."""

from __future__ import annotations

import ronna_hw.command_line.early_interruption  # noqa: F401 - first of all: imports can be interrupted

# isort: split
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ronna_hw.command_line import terminal
from ronna_hw.command_line.errors import UsageMistake
from ronna_hw.command_line.options import require_folder_of
from ronna_hw.errors import EXIT_DONE, EXIT_FAILED
from ronna_hw.text import format_count

if TYPE_CHECKING:
    from drivers.ndi_polaris.tool_definition import ToolDefinition

app = typer.Typer(
    name="ronna-rom",
    help="Write, show, compare and check tool definitions (.rom) of an NDI tracker.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
)

RomArgument = Annotated[
    Path, typer.Argument(metavar="ROM", help="A .rom, or the name of one shipped with the driver.")
]
ToleranceOption = Annotated[
    float | None, typer.Option("--tolerance-mm", min=0.0, help="Distances closer than this are too similar.")
]


@app.command()
def make(
    description: Annotated[
        Path, typer.Argument(metavar="TOML", help="Tool description: part_number, markers_mm, ...")
    ],
    out: Annotated[Path, typer.Option("--out", metavar="FILE", help="File to write the .rom to.")],
    as_json: terminal.JsonOption = False,
) -> int:
    """Write a definition from marker coordinates.

    A description needs at least part_number and markers_mm (a list of [x, y, z]); show --toml prints a full
    one for an existing definition. Exit codes: 0 written, possibly with warnings about similar distances;
    1 the description is wrong or the file cannot be written.
    """
    from drivers.ndi_polaris.tool_comparison import find_alike
    from drivers.ndi_polaris.tool_definition import decode_definition, definition_hash, encode_definition
    from drivers.ndi_polaris.tool_description import read_description
    from ronna_hw.records import write_atomically

    require_folder_of(out)
    block = encode_definition(read_description(description).definition())
    tool = decode_definition(block)
    write_atomically(out, block)
    warnings = [str(pair) for pair in find_alike({tool.part_number: tool})]
    if tool.unique_geometry and warnings:
        warnings.append("the definition claims unique geometry; set unique_geometry = false")
    if as_json:
        terminal.print_json(
            {
                "file": str(out),
                "bytes": len(block),
                "sha256": definition_hash(tool),
                "warnings": warnings,
                "tool": _tool_document(tool),
            }
        )
    else:
        terminal.tell(f"{out}: {tool.part_number}, {len(tool.markers_mm)} markers, {len(block)} bytes")
    for warning in warnings:
        terminal.tell(f"warning: {warning}")
    return EXIT_DONE


@app.command()
def show(
    rom: RomArgument,
    as_toml: Annotated[
        bool, typer.Option("--toml", help="Print the description, in the format read by make.")
    ] = False,
    as_json: terminal.JsonOption = False,
) -> int:
    """Show the content of a definition. Exit codes: 0 shown, 1 not a usable definition."""
    import sys

    from drivers.ndi_polaris.tool_comparison import segment_lengths_mm
    from drivers.ndi_polaris.tool_definition import definition_hash
    from drivers.ndi_polaris.tool_description import describe_tool

    if as_toml and as_json:
        raise UsageMistake("--toml and --json are mutually exclusive", action="Give one of them.")
    tool = _read_tool(rom)
    if as_toml:
        import tomli_w

        sys.stdout.write(tomli_w.dumps(describe_tool(tool)))
        return EXIT_DONE
    segments = segment_lengths_mm(tool.markers_mm)
    if as_json:
        lengths = [round(length, 3) for length in segments]
        terminal.print_json({**_tool_document(tool), "segments_mm": lengths, "sha256": definition_hash(tool)})
        return EXIT_DONE
    per_marker = ("markers_mm", "normals", "faces")
    content = {name: value for name, value in describe_tool(tool).items() if name not in per_marker}
    content["segments_mm"] = ", ".join(f"{length:.2f}" for length in segments)
    content["sha256"] = definition_hash(tool)
    terminal.print_table(rom.name, ("property", "value"), list(content.items()))
    markers = zip(tool.markers_mm, tool.normals, tool.faces, strict=True)
    rows = [
        (number, *(f"{value:.3f}" for value in marker), " ".join(f"{value:.3f}" for value in normal), face)
        for number, (marker, normal, face) in enumerate(markers, start=1)
    ]
    terminal.print_table("Markers", ("marker", "x mm", "y mm", "z mm", "normal", "face"), rows)
    return EXIT_DONE


@app.command()
def compare(first: RomArgument, second: RomArgument, as_json: terminal.JsonOption = False) -> int:
    """Show the differences between two definitions.

    Field by field; marker positions by their distance in mm, unexplained bytes in hex.
    Exit codes: 0 no difference, 1 a difference, or one is not a usable definition.
    """
    from dataclasses import asdict

    from drivers.ndi_polaris.tool_comparison import compare_definitions, largest_segment_difference_mm

    tools = _read_tool(first), _read_tool(second)
    differences = compare_definitions(*tools)
    shape_mm = largest_segment_difference_mm(*tools)
    if as_json:
        terminal.print_json(
            {
                "same": not differences,
                "largest_segment_difference_mm": shape_mm,
                "differences": [asdict(difference) for difference in differences],
            }
        )
    elif differences:
        terminal.print_table(
            f"{first.name} and {second.name}",
            ("field", first.name, second.name, "apart mm"),
            [
                (d.field, d.first, d.second, "" if d.distance_mm is None else f"{d.distance_mm:.3f}")
                for d in differences
            ],
        )
    summary = "no difference" if not differences else format_count(len(differences), "difference")
    shape = "" if shape_mm is None else f"; marker distances differ by at most {shape_mm:.3f} mm"
    terminal.tell(summary + shape)
    return EXIT_FAILED if differences else EXIT_DONE


@app.command()
def check(
    roms: Annotated[list[Path], typer.Argument(metavar="ROM...", help="Definitions used together.")],
    tolerance_mm: ToleranceOption = None,
    as_json: terminal.JsonOption = False,
) -> int:
    """Check that marker distances are unique.

    Within a tool, and between tools that are used together.
        Exit codes: 0 unique, 1 not unique, or a file is not a usable definition.
    """
    from dataclasses import asdict
    from itertools import combinations

    from drivers.ndi_polaris.tool_comparison import SEGMENT_TOLERANCE_MM, find_alike, shares_triangle

    tolerance = SEGMENT_TOLERANCE_MM if tolerance_mm is None else tolerance_mm
    tools = {_short_name(path, roms): _read_tool(path) for path in roms}
    if len(tools) < len(roms):
        twice = {str(rom) for rom in roms if roms.count(rom) > 1} or {str(rom) for rom in roms}
        raise UsageMistake(
            f"a definition was given twice: {', '.join(sorted(twice))}",
            expected="definitions of different files",
            action="Give each definition once.",
        )
    alike = find_alike(tools, tolerance)
    triangles = [
        (a, b) for (a, first), (b, second) in combinations(tools.items(), 2) if shares_triangle(first, second)
    ]
    if as_json:
        terminal.print_json(
            {
                "tolerance_mm": tolerance,
                "alike": [asdict(pair) for pair in alike],
                "not_told_apart": [list(pair) for pair in triangles],
            }
        )
    else:
        for a, b in triangles:
            terminal.tell(f"{a} and {b} share a triangle of markers: the driver refuses to load both")
        for pair in alike:
            terminal.tell(str(pair))
        if not alike:
            terminal.tell(
                f"{format_count(len(tools), 'tool')}: all distances differ by at least {tolerance:g} mm"
            )
    return EXIT_FAILED if alike or triangles else EXIT_DONE


def _read_tool(path: Path) -> ToolDefinition:
    from drivers.ndi_polaris.shipped_tools import find_definition
    from drivers.ndi_polaris.tool_definition import read_definition

    return read_definition(find_definition(path))


def _short_name(path: Path, others: list[Path]) -> str:
    """Return a file's stem, or its full path if the stem is ambiguous."""
    return path.stem if sum(other.stem == path.stem for other in others) == 1 else str(path)


def _tool_document(tool: ToolDefinition) -> dict[str, Any]:
    from drivers.ndi_polaris.tool_description import describe_tool

    return {**describe_tool(tool), "made_on": tool.made_on.isoformat()}


def main() -> None:
    """Run the console script."""
    terminal.run(app)


if __name__ == "__main__":
    main()
