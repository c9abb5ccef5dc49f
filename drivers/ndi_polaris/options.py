"""Tracker options in the theatre file.

[tracker.options]
tools = [{ name = "robot_frame", rom = "robot_frame.rom" }]
expected_model = "spectra"
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, field_validator, model_validator

from drivers.ndi_polaris.errors import BAD_OPTIONS, FOREIGN_TOOL
from drivers.ndi_polaris.shipped_tools import find_definition
from drivers.ndi_polaris.tool_comparison import check_distinct
from drivers.ndi_polaris.tool_definition import ToolDefinition, definition_hash, read_definition
from drivers.theatre_options import parse_options
from ronna_hw.calibration import Strict
from ronna_hw.config import DeviceConfig
from ronna_hw.wire.polaris import COMM_BAUD_CODES, COMMAND_TIMEOUT_S, PolarisModel


class ToolOption(Strict):
    """Passive tool to be tracked."""

    name: Annotated[str, Field(min_length=1, description="Name of the tool in readings and calibrations.")]
    rom: Annotated[
        str,
        Field(
            min_length=1,
            description="Path relative to the theatre file, or the name of a definition "
            "shipped with the driver.",
        ),
    ]
    priority: Annotated[
        Literal["S", "D"], Field(description="Tracking priority: S for a static tool, D for a dynamic one.")
    ] = "D"
    sha256: Annotated[
        str | None,
        Field(pattern="^[0-9a-f]{64}$", description="SHA-256 of the definition; any other is refused."),
    ] = None

    def definition(self, folder: Path | None = None) -> ToolDefinition:
        """Read the tool definition; raises NDI-011, or NDI-013 if its hash differs from `sha256`."""
        definition = read_definition(find_definition(Path(self.rom), folder))
        found = definition_hash(definition)
        if self.sha256 not in (None, found):
            raise FOREIGN_TOOL(
                f"{self.rom} is not the definition configured for tool {self.name}",
                expected=f"sha256 {self.sha256}",
                got=found,
            )
        return definition


class PolarisOptions(Strict):
    """Polaris tracker options, all with working defaults."""

    tools: Annotated[
        tuple[ToolOption, ...],
        Field(description="Tools to track; without any, a dummy tool is loaded so that strays are measured."),
    ] = ()
    expected_model: Annotated[
        PolarisModel | None, Field(description="Expected model; any other is refused.")
    ] = None
    expected_serial: Annotated[
        str | None, Field(description="Expected serial number; any other unit is refused.")
    ] = None
    illuminator_rate_hz: Annotated[
        Literal[20, 30, 60], Field(description="Measurements per second; the unit may keep its own rate.")
    ] = 60
    maximum_baud: Annotated[int, Field(description="Fastest baud rate to try.")] = 921600
    reply: Annotated[
        Literal["auto", "BX", "TX"], Field(description="auto: binary, or text if the unit has no BX.")
    ] = "auto"
    volume: Annotated[
        int | None,
        Field(
            ge=1, le=9, description="Number of the measuring volume, from 1; default: the unit's current one."
        ),
    ] = None
    stray_to_marker_mm: Annotated[
        float, Field(gt=0, description="A stray within this distance of a tool's marker is that marker.")
    ] = 5.75
    first_marker_is_first_digit: Annotated[
        bool, Field(description="TX states the markers of a tool from the first on (unconfirmed).")
    ] = True
    first_marker_is_first_nibble: Annotated[
        bool, Field(description="BX states the markers of a tool from the first on (unconfirmed).")
    ] = False
    time_limits_s: Annotated[
        dict[str, Annotated[float, Field(gt=0)]],
        Field(default_factory=dict, description="Time limits by command that override the unit's own."),
    ]

    @field_validator("maximum_baud")
    @classmethod
    def _require_known_rate(cls, baud: int) -> int:
        if baud not in COMM_BAUD_CODES.values():
            rates = ", ".join(str(rate) for rate in sorted(COMM_BAUD_CODES.values()))
            raise ValueError(f"expected one of {rates}")
        return baud

    @model_validator(mode="after")
    def _require_consistent(self) -> Self:
        names = [tool.name for tool in self.tools]
        if duplicates := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"duplicate tool name {', '.join(duplicates)}")
        if unknown_commands := sorted(set(self.time_limits_s) - set(COMMAND_TIMEOUT_S)):
            raise ValueError(f"time_limits_s: unknown command {', '.join(unknown_commands)}")
        return self

    def definitions(self, folder: Path | None = None) -> dict[str, ToolDefinition]:
        """Read all tool definitions, with paths relative to `folder`; raises NDI-011 to NDI-013."""
        tools = {tool.name: tool.definition(folder) for tool in self.tools}
        check_distinct(tools, {tool.name: tool.rom for tool in self.tools})
        return tools

    def limits_s(self) -> dict[str, float]:
        """Return the time limits by command: defaults, overridden by the theatre file."""
        return {**COMMAND_TIMEOUT_S, **self.time_limits_s}


def read_options(config: DeviceConfig) -> PolarisOptions:
    """Parse the tracker options from the theatre file; raises NDI-010 listing every mistake."""
    return parse_options(PolarisOptions, config.options, "tracker options", BAD_OPTIONS)
